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
# # Taken: the queries that distractors win
#
# Each of these queries retrieves its place from the database alone, and an image of another place once images under its own
# condition are added. Choose a dataset and a method; the arrow keys go on.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
most: int = 8  # queries shown of a dataset and a method, from 1, evenly spread over all
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from itertools import product

from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, methods=methods, most=most, seed=seed).single_stage()
found = {
    (name, method): studies.per_query.taken(page.manifest, name, method, most, seed=seed)
    for name, method in product(page.datasets, page.methods)
}

# %% tags=["remove-input", "full-width"]
display(pages.common.label(page.label))
pages.taken.browser(found, page.method_titles)

# %% [markdown]
# ## Every query
#
# All evaluated queries of all datasets and methods are a download of [Table III](tab03.ipynb), one row each; under suppression,
# of [Fig. 8](fig08.ipynb). Their columns:

# %% tags=["remove-input"]
pages.taken.columns_table()

# %% tags=["remove-input"]
pages.provenance.provenance(page, *(described for described, _ in found.values()))
