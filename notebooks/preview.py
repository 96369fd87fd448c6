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
# # A dataset at a glance
#
# Look at a dataset before its results: how many images each traversal has and how far apart they are, how many queries have a
# positive and how many, and whether the traversals differ in size, colour or brightness. `dataset` takes a name of the manifest
# or the path of a folder; `python -m artifact data add` shows the same in the terminal.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first of the profile with real images, else the first
places: int = 5  # places shown, from 1

# %% tags=["hide-input"]
from artifact import pages, studies
from artifact.pages import galleries
from artifact.pages.scope import open_page

page = open_page(profile, dataset=dataset, places=places)
page = page.choose(prefer="real")
look = studies.preview.look_at(page.manifest, page.dataset)
loaded = look.dataset

# %% tags=["remove-input"]
pages.common.join(
    [pages.common.label(f"{loaded.title}, {loaded.shift}"), pages.preview.facts(look.facts, look.remarks)]
)

# %% tags=["remove-input", "full-width"]
pages.preview.traversals_table(look.traversals, loaded.unit)

# %% tags=["remove-input"]
pages.preview.positions_figure(loaded)

# %% tags=["remove-input", "full-width"]
galleries.contact_sheet(loaded, places)

# %% tags=["remove-input"]
pages.provenance.provenance(page)
