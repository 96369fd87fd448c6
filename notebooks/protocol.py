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
# # Protocol
#
# What the paper fixes and what it leaves open. Each row is a parameter or a rule of the library with the default used
# everywhere in this book. Below, the open choices that are cheap to vary are varied.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
k: int = 1  # K of R@K and DAR@K, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages
from artifact.pages.scope import open_page
from artifact.studies import protocol

page = open_page(profile, datasets=datasets, methods=methods, k=k, seed=seed)

# %% tags=["remove-input", "full-width"]
pages.protocol.protocol_table(protocol.decisions())

# %% [markdown]
# ## What the open choices change
#
# *Similarity*: Euclidean distance and dot product rank unit-length descriptors exactly as the cosine does, so they are
# not listed. *Ties*: the difference when images that are level with the best positive count against the query.
# *Excluded queries*: the difference when queries without a positive stay in the denominator. *Threshold*: DAR when
# only distractors beyond twice the threshold are used, which shows how much depends on images just outside it.
# *Database order*, *tile sizes* and *number of worker processes* change nothing; the tests assert it.

# %% tags=["remove-input"]
study = protocol.sensitivity(page.manifest, page.datasets, page.methods, k=k, seed=seed)
display(pages.common.label(page.label))
pages.protocol.sensitivity_table(study.table, page.method_titles, k=k)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "protocol_sensitivity"))
pages.provenance.provenance(page, study)
