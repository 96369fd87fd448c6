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
# # Full run: what the whole paper takes
#
# Eleven methods on six datasets, from images to every table and figure: `make reproduce PROFILE=paper`. The hours below are a
# plan, not a run: each step was probed for a few seconds on the machine that the table names, and scaled by the sizes of the
# paper's datasets. `make plan PROFILE=paper` makes the same plan for your machine and says what does not fit it,
# `make plan PROFILE=paper WORKERS="1 8 64"` for many.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile)
planned = studies.catalogue.full_run()

# %% tags=["remove-input", "full-width"]
pages.catalogue.full_run_table(planned)

# %% [markdown]
# *Extraction* describes every image once and is most of the time without a GPU. *Suppressed* ranks the suppressed descriptors.
# Images are those whose descriptors are still to be made. [A new dataset or method](../new.md) says how to get data and weights.

# %% tags=["remove-input"]
display(pages.common.download(planned, "full_run", "the plan for every method and dataset"))
pages.provenance.provenance(page)
