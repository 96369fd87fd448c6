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
# # Table II: methods
#
# What each method is, how images are prepared for it, and how fast it ran here. *Baselines* run on any machine with
# no download and are not methods of the paper; they keep every page of this book real.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # datasets whose extraction times are shown; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, methods=methods)
study = studies.catalogue.methods_table(page.manifest, page.datasets, page.methods)

# %% [markdown]
# ## Methods of this run

# %% tags=["remove-input", "full-width"]
pages.catalogue.methods_table(study.table)

# %% [markdown]
# *Images per second* is the model's own forward rate while extracting, *busy* the share of the extraction's wall time
# that the model was computing; both are of the machine that extracted the descriptors.
#
# ## The paper's Table II
#
# All eleven are here; [The paper's methods](methods.ipynb) shows how each is held to its authors' model, the terms of the
# weights and how to get them.

# %% tags=["remove-input", "full-width"]
pages.catalogue.reported_methods_table(page.manifest, studies.catalogue.methods_of_the_paper(page.manifest))

# %% tags=["remove-input"]
display(pages.common.download(study.table, "tab02_methods"))
display(pages.common.download(studies.reported.table("tab02"), "tab02_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
