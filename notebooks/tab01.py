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
profile = "demo"
datasets = None  # names from the manifest or folders; None takes all of the profile

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets)
study = studies.catalogue.datasets_table(page.manifest, page.datasets)

# %% tags=["remove-input", "full-width"]
pages.catalogue.datasets_table(study.table)

# %% [markdown]
# *#Query* counts the images of the query traversal; *evaluated* are those with at least one positive, the others leave
# numerator, denominator and distractor pool. *Positives* is the median number per evaluated query. *Mirrors* names the
# dataset of the paper whose protocol a rendered pair follows; it says nothing about its difficulty.
#
# ## The paper's Table I

# %% tags=["remove-input"]
pages.catalogue.reported_datasets_table()

# %% [markdown]
# RobotCar lists 6,021 queries, but every percentage that the paper prints for it is a whole number of 5,987: 34
# queries have no database image within 25 m and are excluded, as the paper's text says. The tests of this artifact
# assert it for all 22 values of the scatter plot and all values of the sweeps.

# %% tags=["remove-input"]
display(pages.common.download(study.table, "tab01_datasets"))
pages.provenance.provenance(page, study)
