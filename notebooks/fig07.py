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
# # Fig. 7: the condition of the distractors
#
# DAR with distractors from traversals of different conditions, the same number from each. The first set is the query
# set itself (the setting of Table III); *none* is recall. Where a traversal has more images than the smallest, the value is
# the expectation over all choices of so many.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first dataset of the profile with distractor traversals
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
k: int = 1  # K of R@K and DAR@K, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, dataset=dataset, methods=methods, k=k, seed=seed)
page = page.choose(distractor_traversals=True)
study = studies.distractors.distractor_condition(page.manifest, page.dataset, page.methods, k=k, seed=seed)

# %% tags=["remove-input"]
display(
    pages.common.findings(
        pages.distractors.own_condition_hurts_most(study, page.method_titles, page.conditions, k),
        pages.distractors.conditions_between_hurt_less(study, page.conditions, k),
        pages.distractors.database_condition_hurts_little(study, page.conditions, k),
    )
)
display(pages.common.label(page.label))
pages.distractors.condition(study.table, page.method_titles, query_condition=page.conditions[0], k=k)

# %% [markdown]
# ## The paper's Fig. 7
#
# Drawn from the values that the paper plots for RobotCar, not from this run.

# %% tags=["remove-input"]
pages.distractors.reported_condition()

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
pages.verdicts.verdicts_table(
    studies.verdicts.of_curve(study.table, "Fig. 7", page.dataset_titles[page.dataset], "condition"),
    titles=page.method_titles,
)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "fig07_condition"))
display(pages.common.download(studies.reported.table("fig07"), "fig07_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
