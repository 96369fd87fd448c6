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
profile = "demo"
datasets = None  # names from the manifest or folders; None takes all of the profile
methods = None  # names from the manifest; None takes all of the profile
k = 1
seed = 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, methods=methods, k=k, seed=seed)
study = studies.recall.recall_table(page.manifest, page.datasets, page.methods, k=k, seed=seed)

# %% tags=["remove-input"]
display(pages.common.findings(pages.recall.similar_recall_hides_differences(study.table, page.method_titles, k)))
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
pages.provenance.provenance(page, study)
