"""The paper's figures, drawn from tidy tables: the same panels, axes, colours and markers.

Every function returns an image that the page embeds, with a text alternative. Measured and reported values are
never drawn into one figure.
"""

from artifact.figures.embed import embed
from artifact.figures.maps import embeddings, mixed_database
from artifact.figures.retrieval import (
    condition,
    number_and_distance,
    reported_condition,
    reported_number_and_distance,
    reported_scatter,
    retrieval_diagram,
    scatter,
)
from artifact.figures.suppression import (
    fraction_curves,
    heat_maps,
    iterations,
    reported_fraction_curves,
    sided_gaps,
    similarities,
)

__all__ = [
    "condition",
    "embed",
    "embeddings",
    "fraction_curves",
    "heat_maps",
    "iterations",
    "mixed_database",
    "number_and_distance",
    "reported_condition",
    "reported_fraction_curves",
    "reported_number_and_distance",
    "reported_scatter",
    "retrieval_diagram",
    "scatter",
    "sided_gaps",
    "similarities",
]
