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
# # Table I: datasets
#
# A query traversal is matched against a database traversal taken under another condition. A retrieval is correct
# within the threshold: a distance in metres, a tolerance in frames for frame-aligned traversals, or the exact partner.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets)
study = studies.catalogue.datasets_table(page.manifest, page.datasets)
beside = studies.catalogue.beside_the_paper(page.manifest, study.table)

# %% tags=["remove-input", "full-width"]
pages.catalogue.datasets_table(study.table)

# %% [markdown]
# *#Query* counts the images of the query traversal; *evaluated* are those with at least one positive, the others leave
# numerator, denominator and distractor pool. *Positives* is the median number per evaluated query. *Mirrors* names the
# dataset of the paper whose protocol a rendered pair follows; it says nothing about its difficulty.
#
# ## The paper's Table I

# %% tags=["remove-input", "full-width"]
pages.catalogue.beside_the_paper(beside)

# %% [markdown]
# RobotCar lists 6,021 queries, but every percentage that the paper prints for it is a whole number of 5,987: 34
# queries have no database image within 25 m and are excluded, as the paper's text says. The tests of this artifact
# assert it for all 22 values of the scatter plot and all values of the sweeps.
#
# `make data DATASET=…` makes each of them from the files that its owners publish; a count that differs from the paper's is
# shown on every page that uses the dataset.

# %% tags=["remove-input", "full-width"]
pages.catalogue.terms_table(beside)

# %% [markdown]
# The datasets are those of {cite:t}`yildiz2022amstertime`, {cite:t}`glover2020day`, {cite:t}`sunderhauf2013we`,
# {cite:t}`maddern20171`, {cite:t}`glover2010fab` and {cite:t}`berton2021adaptive`.
#
# ## Each dataset of this run
#
# Where query and database images are, how many positives each query has, and examples: a query, its nearest positive, and
# one of its distractors, an image of the query's condition from another place.

# %% tags=["remove-input", "full-width"]
pages.common.join(pages.catalogue.glance(page.manifest, name) for name in page.datasets)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "tab01_datasets"))
display(pages.common.download(studies.reported.table("tab01"), "tab01_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
