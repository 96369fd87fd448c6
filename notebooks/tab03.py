# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Table III: recall, with and without distractors
#
# Each method ranks every query against the cross-condition database (Recall@K, R@K) and against the same database plus the
# query's distractors (Distractor-Augmented Recall, DAR@K). The Recall Survival Rate, RSR@K = DAR@K / R@K, is the share of
# successes that survive {cite:p}`kim2026places`.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
k: int = 1  # K of R@K and DAR@K, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, methods=methods, k=k, seed=seed)
study = studies.recall.recall_table(page.manifest, page.datasets, page.methods, k=k, seed=seed)

# %% tags=["remove-input", "full-width"]
display(
    pages.common.findings(
        pages.recall.distractors_lower_recall(study, page.method_titles, k),
        pages.recall.ranking_changes(study, page.method_titles, k),
        pages.recall.mean_ranking_changes(study, page.method_titles, k),
    )
)
pages.recall.recall_table(study.table, page.method_titles, k=k, label=page.label)

# %% [markdown]
# <b class="legend-mark best">best</b> <u class="legend-mark second">second</u>
# <i class="legend-mark worst">worst</i> per column; superscripts rank the means (1 is best). All values in
# percent, higher is better. The mean is over all datasets shown.
#
# ## Measured beside reported
#
# Intervals are 95 % block-bootstrap intervals over consecutive queries: neighbouring images succeed and fail together, so
# treating them as independent would give intervals that are too narrow. A verdict is given only where the paper
# reports the same dataset with the same method.

# %% tags=["remove-input"]
pages.recall.beside_reported(study.table, page.method_titles, k=k)

# %% [markdown]
# ## The paper's Table III
#
# For comparison, the paper's own numbers for its eleven methods and six datasets. They are not from this run.

# %% tags=["remove-input", "full-width"]
pages.recall.reported_recall_table()

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
pages.verdicts.verdicts_table(studies.verdicts.of_recall(study.table), titles=page.method_titles)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "tab03_recall"))
display(pages.common.download(studies.reported.table("tab03"), "tab03_reported", "what the paper reports"))
queries = studies.per_query.per_query(page.manifest, page.datasets, page.methods, seed=seed)
display(pages.common.download(queries.table, "tab03_queries", compressed=True))
pages.provenance.provenance(page, study)
