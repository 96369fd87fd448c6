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
# # Fig. 3: descriptors before and after suppression
#
# UMAP {cite:p}`mcinnes2018umap` lays descriptors out in the plane. Gray lines join a query and a database image that are
# each other's nearest neighbour *on the ground*. If condition dominates, the two conditions form separate clouds and the lines
# are long; if place dominates, the clouds overlap and the lines are short. UMAP bends distances: what is measured are neighbours.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes one of the profile, with a threshold in metres if there is one
method: str = None  # a name; None takes the last method of the profile that does not re-rank
fraction: float = 0.1  # of the queries, for fitting, 0 to 1; the rest is shown
iterations: int = 35  # of INLP, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import Markdown, display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, dataset=dataset, method=method, fraction=fraction, iterations=iterations, seed=seed)
page = page.choose(prefer="metres", single_stage=True)
one = studies.embedding.embedding(
    page.manifest, page.dataset, page.method, fraction=fraction, iterations=iterations, seed=seed
)

# %% tags=["remove-input", "full-width"]
display(
    pages.common.findings(
        pages.embedding.suppression_mixes_conditions(one, seed), pages.embedding.suppression_aligns_places(one, seed)
    )
)
display(pages.common.label(page.label))
pages.embedding.embedding(one, page.conditions, page.method_titles[page.method])

# %% [markdown]
# ## How mixed the clouds are

# %% tags=["remove-input"]
before, after = (100 * studies.embedding.nearest_share(points, one) for points in (one.before, one.after))
Markdown(
    f"Mixing, measured in the plane: the share of points whose nearest neighbour has the other condition rises from "
    f"{before:.0f} % to {after:.0f} %."
    if after > before
    else f"Mixing, measured in the plane: the share of points whose nearest neighbour has the other condition goes from "
    f"{before:.0f} % to {after:.0f} %: suppression does not mix these clouds."
)

# %% tags=["remove-input"]
display(pages.common.download(studies.embedding.embedding_table(one), "fig03_umap"))
pages.provenance.provenance(page, one.described)
