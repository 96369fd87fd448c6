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
# on the rest of the map: no place is in both. (a) A linear classifier (the *guardedness probe*) tells query from database on
# descriptors that it was not trained on. (b, c) DAR and R, suppressed minus original.

# %% tags=["parameters", "hide-input"]
profile = "demo"
datasets = None  # names from the manifest or folders; None takes all of the profile
methods = None  # names from the manifest; None takes all of the profile
fraction = 0.1
iterations = 35
k = 1
seed = 0

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
display(
    pages.common.findings(
        pages.suppression.labels_less_accessible(study.table),
        pages.suppression.suppression_raises_dar(study.table, page.method_titles, k),
        pages.suppression.suppression_keeps_recall(study.table, page.method_titles, k),
    )
)
display(pages.common.label(page.label))
pages.suppression.heat_maps(study.table, page.method_titles, k=k)

# %% [markdown]
# Blue is better in all panels. With a handful of images per region (see the table) STD estimates a mean and a deviation for
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
pages.provenance.provenance(page, study)
