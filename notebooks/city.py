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
# # The City: a rendered town
#
# The embedded dataset, so that every page runs on any machine with no download. It is plainly a rendering: a
# procedural town with streets, buildings, trees, lamps and traffic, drawn by ray casting from a seed. Traversals of a
# route differ as real drives do: lateral offset, heading, exposure, frame phase, parked and moving cars. Six pairs mirror
# the protocols of the paper's six datasets, so that all tables and figures have all their columns.
#
# ## What it is for
#
# Nothing measured on it says how a method performs in the world. It shows that the machinery works, and whether the
# paper's claims hold in a place where the cause is known: only the rendering's condition changes.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # rendered datasets; None takes all of the profile
places: int = 5  # places shown per pair, from 1

# %% tags=["hide-input"]
from IPython.display import Markdown, display

from artifact import pages
from artifact.pages import galleries
from artifact.pages.common import plain
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, places=places)
page = page.only(*page.rendered)

# %% tags=["remove-input", "full-width"]
for name in page.datasets:
    dataset = page.load_all(name)
    entry = page.manifest.dataset(name)
    display(
        Markdown(
            f"## {plain(dataset.title)}\n\nMirrors the protocol of {plain(entry.mirrors)}: {len(dataset.query)} queries "
            f"(*{plain(dataset.query_name)}*), {len(dataset.database)} database images (*{plain(dataset.database_name)}*), "
            f"threshold {entry.threshold}."
        )
    )
    display(galleries.contact_sheet(dataset, places))
if not page.datasets:
    display(Markdown("This profile has no rendered dataset."))

# %% tags=["remove-input"]
pages.provenance.provenance(page)
