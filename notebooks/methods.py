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
# # The paper's methods
#
# The eleven methods are here as plain PyTorch, written for this artifact from the papers and the released checkpoints:
# `artifact.methods.build("salad")` returns the architecture, `artifact.methods.load("salad")` the same with its released weights.
# No method needs its authors' code.
#
# ## Held to the authors' models
#
# A released checkpoint fits only the right architecture, but a right-looking architecture can still compute something else: a
# missing epsilon, another interpolation, another order of a transpose. So every model was filled with weights that a recipe
# makes from each tensor's name and shape, the authors' own code was filled with the same, and both described the same
# images. The tests assert the limits below on every run.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile)
catalogue = studies.catalogue.methods_of_the_paper(page.manifest)
parity = studies.catalogue.parity_table(page.manifest)

# %% tags=["remove-input", "full-width"]
pages.catalogue.parity_table(parity)

# %% [markdown]
# SALAD-CM has SALAD's architecture and is compared with the same values. AnyLoc is compared at 112 × 112 pixels: its ViT-g has
# 1.1 billion parameters.
#
# ## Weights on this machine

# %% tags=["remove-input", "full-width"]
pages.catalogue.catalogue_table(catalogue)

# %% tags=["remove-input"]
pages.catalogue.how_to_get(catalogue)

# %% tags=["remove-input"]
display(pages.common.download(parity, "methods_parity"))
display(pages.common.download(catalogue.drop(columns="how"), "methods_catalogue"))
pages.provenance.provenance(page)
