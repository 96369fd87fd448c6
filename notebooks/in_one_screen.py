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
profile = "demo"
dataset = None  # None takes the first dataset of the profile whose images are real, else the first
method = None  # None takes the last method of the profile that does not re-rank

# %% [markdown]
# ## Descriptors and positions
#
# Every traversal is an array of descriptors, one row for each image, and an array of positions in metres or frames.

# %%
import numpy as np

import artifact
from artifact import pages, studies
from artifact.extraction.described import describe
from artifact.pages.scope import open_page

page = open_page(profile, dataset=dataset, method=method).choose(prefer="real", single_stage=True)
described = describe(page.manifest, page.dataset, page.method)
queries, database = described.query.values, described.database.values
query_positions, database_positions = described.dataset.query.positions, described.dataset.database.positions
threshold = described.dataset.threshold
queries.shape, database.shape, query_positions.shape, threshold


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


def recall_and_dar(queries, database, query_positions, database_positions):
    """R@1 and DAR@1 in percent; the distractors are the queries themselves."""
    positive = distances(query_positions, database_positions) <= threshold
    evaluated = positive.any(axis=1)  # a query without a positive is excluded, also as a distractor
    queries, query_positions, positive = queries[evaluated], query_positions[evaluated], positive[evaluated]
    distractor = distances(query_positions, query_positions) > threshold
    to_database, to_queries = unit(queries) @ unit(database).T, unit(queries) @ unit(queries).T
    best = np.where(positive, to_database, -np.inf).max(axis=1, keepdims=True)
    outranked = (to_database > best).sum(axis=1)
    outranked_by_distractors = (distractor & (to_queries > best)).sum(axis=1)
    return 100 * np.mean(outranked < 1), 100 * np.mean(outranked + outranked_by_distractors < 1)


recall, dar = recall_and_dar(queries, database, query_positions, database_positions)
f"R@1 {recall:.2f} %, DAR@1 {dar:.2f} %, RSR@1 {100 * dar / recall:.2f} %"

# %% [markdown]
# The library counts the same in tiles, for every K and both sweeps at once:

# %%
result = artifact.evaluate(queries, database, query_positions, database_positions, threshold)
f"R@1 {100 * result.recall(1):.2f} %, DAR@1 {100 * result.dar(1):.2f} %, RSR@1 {100 * result.rsr(1):.2f} %"

# %% [markdown]
# ## Condition suppression
#
# LEACE is fitted on the tenth of the queries around the centre and the database images at their places. It is evaluated on the
# rest, so no place is in both.

# %%
region = artifact.split(query_positions, database_positions, threshold, fraction=0.1)
fit_queries, fit_database = queries[region.fit_queries], database[region.fit_database]
condition = np.repeat(["query", "database"], [len(fit_queries), len(fit_database)])
leace = artifact.LEACE().fit(np.concatenate([fit_queries, fit_database]), condition)

rest_queries, rest_database = queries[region.evaluation_queries], database[region.evaluation_database]
places = query_positions[region.evaluation_queries], database_positions[region.evaluation_database]
original = recall_and_dar(rest_queries, rest_database, *places)
suppressed = recall_and_dar(leace.transform(rest_queries), leace.transform(rest_database), *places)
f"R@1 {original[0]:.2f} → {suppressed[0]:.2f} %, DAR@1 {original[1]:.2f} → {suppressed[1]:.2f} %"

# %% [markdown]
# ## The same numbers as in the book

# %%
table3 = studies.recall.recall_table(page.manifest, [page.dataset], [page.method])
fig8 = studies.suppression.suppression_table(page.manifest, [page.dataset], [page.method])
changed = fig8.table.set_index("suppression").loc["LEACE"]
book = table3.table.loc[0, ["R", "DAR"]].tolist() + changed[["R", "DAR", "change_R", "change_DAR"]].tolist()
here = [recall, dar, *suppressed, *np.subtract(suppressed, original)]
np.testing.assert_allclose(here, book, rtol=0, atol=1e-9)

# %% tags=["remove-input"]
from IPython.display import display

names = ["R@1", "DAR@1", "R@1 with LEACE", "DAR@1 with LEACE", "ΔR@1", "ΔDAR@1"]
source = ["Table III"] * 2 + ["Fig. 8"] * 4
rows = [
    {"Quantity": name, "Shown in": shown, "Here": f"{value:.2f}", "In the book": f"{same:.2f}"}
    for name, shown, value, same in zip(names, source, here, book, strict=True)
]
display(pages.common.label(page.label))
display(pages.common.table(rows, text=2, caption="Shares in percent, changes in percentage points."))
pages.provenance.provenance(page, described)
