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
# # How sure
#
# Had the traversals been driven once more, would the methods stand in the same order? Neighbouring queries succeed and fail
# together, so blocks of consecutive queries are drawn anew along each traversal, 1,000 times, the same ones for all methods
# (a paired circular block bootstrap). Each draw gives a mean of R@K and of DAR@K over the datasets, and an order.

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
display(pages.common.label(page.label))
for metric in ("R", "DAR"):
    chances = studies.how_sure.rank_chances(study, metric)
    display(pages.how_sure.rank_table(chances, page.method_titles, heading=f"{metric}@{k}"))

# %% [markdown]
# ## Who is told from whom
#
# A pair of methods is told apart if the difference of their means is beyond chance at 5 %, adjusted for the number of pairs
# (Holm). For the others the run is too small to say which is better.

# %% tags=["remove-input"]
for metric in ("R", "DAR"):
    differences = studies.how_sure.separable(study, metric)
    display(pages.how_sure.separable_table(differences, page.method_titles, heading=f"{metric}@{k}"))

# %% tags=["remove-input"]
display(pages.common.download(studies.how_sure.separable(study, "DAR"), "how_sure_separable"))
pages.provenance.provenance(page, study)
