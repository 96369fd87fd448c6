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
# # Fig. 8: what condition suppression changes
#
# Each transform is fitted on the 10 % of the queries nearest to the centre and the database images around them, and evaluated
# on the rest of the map: no place is in both. Three transforms are compared: Iterative Nullspace Projection (INLP)
# {cite:p}`ravfogel2020null`, Least-squares Concept Erasure (LEACE) {cite:p}`belrose2023leace` and Standardization of Descriptors
# (STD) {cite:p}`schubert2020unsupervised`. Changes are in percentage points (pp). (a) A linear classifier (the *guardedness probe*) tells query from database on
# descriptors that it was not trained on. (b, c) DAR and R, suppressed minus original.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
fraction: float = 0.1  # of the queries, for fitting: 0 to 1
iterations: int = 35  # of INLP, from 1
k: int = 1  # K of R@K and DAR@K, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, methods=methods, fraction=fraction, iterations=iterations, k=k, seed=seed)
page = page.single_stage()
study = studies.suppression.suppression_table(
    page.manifest, page.datasets, page.methods, fraction=fraction, iterations=iterations, k=k, seed=seed
)

# %% tags=["remove-input", "full-width"]
display(pages.common.findings(*pages.suppression.of_changes(study, page.method_titles, k)))
display(pages.common.label(page.label))
pages.suppression.heat_maps(study.table, page.method_titles, k=k)

# %% [markdown]
# Blue is better in all panels, and every cell prints its number. With a handful of images per region (see the table) STD estimates a mean and a deviation for
# every dimension from very little data; [Fig. 10](fig10.ipynb) shows how that changes with the fitting fraction.
#
# ## Pairs that improve

# %% tags=["remove-input"]
pages.suppression.improved_table(study.table, k=k)

# %% [markdown]
# ## All values

# %% tags=["remove-input", "full-width"]
pages.suppression.suppression_table(study.table, page.method_titles, k=k)

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
in_the_paper = (fraction, iterations, k) == (0.1, 35, 1)
compared = [studies.verdicts.of_counts(study.table)] if in_the_paper else []
pages.verdicts.verdicts_table(*compared, titles=page.method_titles)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "fig08_suppression"))
display(pages.common.download(studies.reported.table("fig08"), "fig08_reported", "what the paper reports"))
queries = studies.per_query.per_query_suppressed(
    page.manifest, page.datasets, page.methods, fraction=fraction, iterations=iterations, seed=seed
)
display(pages.common.download(queries.table, "fig08_queries", compressed=True))
pages.provenance.provenance(page, study)
