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
# # How fast, and how exact
#
# A rank is decided by the exact similarities of the stored descriptors: real numbers, the same on every machine. Wherever a fast
# matrix product cannot decide, because the difference is within a proven bound of its error, the pair is looked at again in
# float64, and where that cannot decide either, in whole numbers of any length. So ranks, ties and retrieval lists depend on no
# block size, number of threads, library or device.
#
# What that costs is measured here while the page is made, in one run, against the least that any evaluation by float32 products
# does: a bare one of all queries with the database and with themselves, whose results are thrown away, by NumPy or PyTorch,
# whichever is faster. When the distractors are the queries, half of their pairs suffice (dotted line); below it come
# evaluations whose first look is by a faster product, such as three of whole numbers of eight bits. faiss is shown if it is
# installed; it finds the top 100 of the augmented database, without positives and without distances. The sizes are small
# here, so that what is not multiplied (counting, both sweeps, finding positives) weighs more; `make bench` measures larger ones.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
n_queries: int = 2000  # made descriptors, from 1
n_database: int = 2500  # made descriptors, from 1
dimension: int = 2048  # values of a descriptor, from 1
n_views: int = 3  # suppressed views in the same pass, from 1

# %% tags=["hide-input"]
from IPython.display import Markdown, display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, n_queries=n_queries, n_database=n_database, dimension=dimension, n_views=n_views)
growth = studies.how_fast.growth([max(2, n_queries // part) for part in (4, 2, 1)], dimension)
made = studies.how_fast.synthetic(n_queries, n_database, dimension)
times = studies.how_fast.ranking_times(made, n_views=n_views, repeats=2)

# %% tags=["remove-input"]
Markdown(pages.how_fast.costs_sentence(times))

# %% tags=["remove-input", "full-width"]
pages.how_fast.costs_figure(times)

# %% tags=["remove-input", "full-width"]
pages.how_fast.costs_table(times)

# %% tags=["remove-input"]
pages.how_fast.growth_figure(growth)

# %% [markdown]
# Time grows as the number of pairs (here as many queries as database images, and the queries as distractors).
#
# The seconds are those of this machine at that moment: other work on it slows some of them more than others. The counts of pairs
# that were looked at again depend on the product that was chosen; ranks do not.

# %% tags=["remove-input"]
display(pages.common.download(times, "how_fast"))
pages.provenance.provenance(page)
