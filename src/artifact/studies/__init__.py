"""One function per table and figure: inputs named by the manifest, outputs as tidy frames.

Shares are in percent here, as the paper prints them. Every row says what it is from, and every study returns the
record of its inputs.
"""

from artifact.studies.common import METRICS, PERCENT, Study, origin
from artifact.studies.retrieval import (
    datasets_table,
    distractor_condition,
    distractor_distance,
    distractor_number,
    input_in_words,
    methods_table,
    recall_table,
    with_means,
)
from artifact.studies.suppression import (
    fitting_fraction,
    improved,
    irrelevant_conditions,
    mean_by_fraction,
    single_against_multi,
    summary,
    suppression_table,
)

__all__ = [
    "METRICS",
    "PERCENT",
    "Study",
    "datasets_table",
    "distractor_condition",
    "distractor_distance",
    "distractor_number",
    "input_in_words",
    "methods_table",
    "origin",
    "recall_table",
    "with_means",
]
