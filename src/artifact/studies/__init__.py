"""One function per table and figure: inputs named by the manifest, outputs as tidy frames.

Shares are in percent here, as the paper prints them. Every row says what it is from, and every study returns the
record of its inputs.
"""

from artifact.studies.catalogue import methods_of_the_paper, parity_table
from artifact.studies.common import METRICS, PERCENT, Study, origin
from artifact.studies.erased import KINDS, Erased, what_is_erased
from artifact.studies.maps import (
    Embedding,
    MixedDatabase,
    embedding,
    embedding_table,
    mixed_database,
    mixed_database_suppressed,
    mixed_table,
    nearest_share,
)
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
    order_of_fitting,
    single_against_multi,
    summary,
    suppression_table,
)
from artifact.studies.within import within_session

__all__ = [
    "KINDS",
    "METRICS",
    "PERCENT",
    "Embedding",
    "Erased",
    "MixedDatabase",
    "Study",
    "datasets_table",
    "distractor_condition",
    "distractor_distance",
    "distractor_number",
    "embedding",
    "embedding_table",
    "fitting_fraction",
    "improved",
    "input_in_words",
    "irrelevant_conditions",
    "mean_by_fraction",
    "methods_of_the_paper",
    "methods_table",
    "mixed_database",
    "mixed_database_suppressed",
    "mixed_table",
    "nearest_share",
    "order_of_fitting",
    "origin",
    "parity_table",
    "recall_table",
    "single_against_multi",
    "summary",
    "suppression_table",
    "what_is_erased",
    "with_means",
    "within_session",
]
