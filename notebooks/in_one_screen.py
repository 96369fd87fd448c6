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
# # In one screen: the whole method
#
# One dataset, one method, plain NumPy: from descriptors to R@1, DAR@1 and RSR@1, and from LEACE to what it changes. The last
# cell asserts that these are the numbers of [Table III](tab03.ipynb) and [Fig. 8](fig08.ipynb).

# %% tags=["parameters"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first of the profile with real images, else the first
method: str = None  # a name; None takes the last of the profile that does not re-rank

# %% [markdown]
# ## Descriptors and positions
#
# Every traversal is an array of descriptors, one row for each image, and an array of positions in metres or frames.

# %%
import numpy as np
from IPython.display import display

import artifact
from artifact import pages, studies
from artifact.extraction.described import describe
from artifact.pages.scope import open_page

page = open_page(profile, dataset=dataset, method=method)
page = page.choose(prefer="real", single_stage=True, descriptors=True)
described = describe(page.manifest, page.dataset, page.method)
data, threshold = described.dataset, described.dataset.threshold
queries, database = described.query.values, described.database.values
query_places, database_places = data.query.positions, data.database.positions
queries.shape, database.shape, query_places.shape, threshold


# %% [markdown]
# ## Recall, with and without distractors
#
# A query is a hit at 1 if nothing is more similar to it than its best positive. Without distractors only the database competes;
# with them also every other query that lies farther away than the threshold.


# %%
def unit(x):
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def recall_and_dar(queries, database, query_places, database_places):
    """R@1 and DAR@1 in percent; the distractors are the queries themselves."""
    positive = distances(query_places, database_places) <= threshold
    kept = positive.any(axis=1)  # a query without a positive is no distractor either
    queries, query_places, positive = queries[kept], query_places[kept], positive[kept]
    distractor = distances(query_places, query_places) > threshold
    to_database, to_queries = (unit(queries) @ unit(x).T for x in (database, queries))
    best = np.where(positive, to_database, -np.inf).max(axis=1, keepdims=True)
    above = (to_database > best).sum(axis=1)
    distractors_above = (distractor & (to_queries > best)).sum(axis=1)
    return 100 * np.mean(above < 1), 100 * np.mean(above + distractors_above < 1)


recall, dar = recall_and_dar(queries, database, query_places, database_places)
f"R@1 {recall:.2f} %, DAR@1 {dar:.2f} %, RSR@1 {100 * dar / recall:.2f} %"

# %% [markdown]
# The library counts the same in tiles, for every K and both sweeps at once:

# %%
places = query_places, database_places
result = artifact.evaluate(queries, database, *places, threshold)
[f"{100 * value:.2f} %" for value in (result.recall(1), result.dar(1), result.rsr(1))]

# %% [markdown]
# ## Condition suppression
#
# LEACE is fitted on the tenth of the queries around the centre and the database images at their places. It is evaluated on the
# rest, so no place is in both.

# %%
region = artifact.split(*places, threshold, fraction=0.1)
fitted = [queries[region.fit_queries], database[region.fit_database]]
condition = np.repeat(["query", "database"], [len(part) for part in fitted])
leace = artifact.LEACE().fit(np.concatenate(fitted), condition)

rows = region.evaluation_queries, region.evaluation_database
rest = queries[rows[0]], database[rows[1]]
where = query_places[rows[0]], database_places[rows[1]]
original = recall_and_dar(*rest, *where)
suppressed = recall_and_dar(*map(leace.transform, rest), *where)
[f"{a:.2f} → {b:.2f} %" for a, b in zip(original, suppressed, strict=True)]

# %% [markdown]
# ## The same numbers as in the book

# %%
cell = page.manifest, [page.dataset], [page.method]
table3 = studies.recall.recall_table(*cell).table.iloc[0]
fig8 = studies.suppression.suppression_table(*cell).table.set_index("suppression")
book = [*table3[["R", "DAR"]], *fig8.loc["LEACE", ["R", "DAR", "change_R", "change_DAR"]]]
here = [recall, dar, *suppressed, *np.subtract(suppressed, original)]
np.testing.assert_allclose(here, book, rtol=0, atol=1e-9)

# %% tags=["remove-input"]
names = ["R@1", "DAR@1", "R@1 with LEACE", "DAR@1 with LEACE", "ΔR@1", "ΔDAR@1"]
source = ["Table III"] * 2 + ["Fig. 8"] * 4
rows = [
    {"Quantity": name, "Shown in": shown, "Here": f"{value:.2f}", "In the book": f"{same:.2f}"}
    for name, shown, value, same in zip(names, source, here, book, strict=True)
]
shown = pages.common.table(rows, text=2, caption="Shares in percent, changes in percentage points.")
display(pages.common.label(page.label))
display(shown)
pages.provenance.provenance(page, described)
