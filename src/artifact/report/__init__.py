"""How the book shows results: tables in the paper's form, verdicts, downloads and provenance, as HTML.

Everything is plain HTML with classes that ``book/_static/artifact.css`` styles for light and dark pages. Nothing
is fetched: downloads are embedded in the page.
"""

from artifact.report.common import download, finding, findings_table, interval, label, marks, number, table
from artifact.report.methods import catalogue_table, how_to_get, parity_table
from artifact.report.record import code_revision, provenance
from artifact.report.retrieval import (
    beside_reported,
    datasets_table,
    headline,
    methods_table,
    protocol_table,
    recall_table,
    reported_datasets_table,
    reported_methods_table,
    reported_recall_table,
    scope_notice,
    sensitivity_table,
)
from artifact.report.suppression import (
    change,
    equivalence_table,
    erased_similarities,
    erased_table,
    fitting_order,
    improved_table,
    irrelevant_table,
    mixed_table,
    reported_equivalence_table,
    reported_mixed_table,
    single_multi_table,
    suppression_table,
    within_summary,
    within_table,
)

__all__ = [
    "beside_reported",
    "catalogue_table",
    "change",
    "code_revision",
    "datasets_table",
    "download",
    "equivalence_table",
    "erased_similarities",
    "erased_table",
    "finding",
    "findings_table",
    "fitting_order",
    "headline",
    "how_to_get",
    "improved_table",
    "interval",
    "irrelevant_table",
    "label",
    "marks",
    "methods_table",
    "mixed_table",
    "number",
    "parity_table",
    "protocol_table",
    "provenance",
    "recall_table",
    "reported_datasets_table",
    "reported_equivalence_table",
    "reported_methods_table",
    "reported_mixed_table",
    "reported_recall_table",
    "scope_notice",
    "sensitivity_table",
    "single_multi_table",
    "suppression_table",
    "table",
    "within_summary",
    "within_table",
]
