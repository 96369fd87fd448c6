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
# # Fig. 5: DAR against recall
#
# One point per method. Points below the dashed diagonal lose successes to distractors; dotted lines are the means over
# the methods shown.

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

# %% tags=["remove-input"]
display(pages.common.findings(pages.recall.similar_recall_hides_differences(study, page.method_titles, k)))
display(pages.common.label(page.label))
pages.recall.scatter(study.table, page.method_titles, k=k)

# %% [markdown]
# ## The paper's Fig. 5
#
# Drawn from the values that the paper plots, for its eleven methods and six datasets, not from this run.

# %% tags=["remove-input"]
pages.recall.reported_scatter()

# %% tags=["remove-input"]
display(pages.common.download(study.table, "fig05_scatter"))
display(pages.common.download(studies.reported.table("fig05"), "fig05_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
