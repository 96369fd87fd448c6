"""The paper's claims in one line each, and whether the tables of a run agree with them.

A finding is about the data and methods of the run. On other data than the paper's it can support a claim or fail to;
it never reproduces the paper's numbers.
"""

from artifact.findings.collected import DISTANCES, FRACTIONS, RATIOS, Collected, collect
from artifact.findings.finding import CLEARLY_PP, PAGES, SIMILAR_PP, Finding
from artifact.findings.retrieval import (
    database_condition_hurts_little,
    distractors_lower_recall,
    few_distractors_suffice,
    near_distractors_hurt_most,
    own_condition_hurts_most,
    ranking_changes,
    similar_recall_hides_differences,
)
from artifact.findings.suppression import (
    a_tenth_suffices,
    few_images_lower_recall,
    irrelevant_conditions_unharmed,
    labels_less_accessible,
    one_transform_for_all,
    suppression_helps_mixed_database,
    suppression_keeps_recall,
    suppression_raises_dar,
)

__all__ = [
    "CLEARLY_PP",
    "DISTANCES",
    "FRACTIONS",
    "PAGES",
    "RATIOS",
    "SIMILAR_PP",
    "Collected",
    "Finding",
    "a_tenth_suffices",
    "collect",
    "database_condition_hurts_little",
    "distractors_lower_recall",
    "few_distractors_suffice",
    "few_images_lower_recall",
    "irrelevant_conditions_unharmed",
    "labels_less_accessible",
    "near_distractors_hurt_most",
    "one_transform_for_all",
    "own_condition_hurts_most",
    "ranking_changes",
    "similar_recall_hides_differences",
    "suppression_helps_mixed_database",
    "suppression_keeps_recall",
    "suppression_raises_dar",
]
