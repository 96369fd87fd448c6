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
# # Table IV: one transform for many conditions
#
# INLP and LEACE are affine, so transforms compose. *Single*: a transform fitted on the dataset itself. *Multi*: the composition
# of all datasets' transforms, each fitted on descriptors that the earlier ones have already changed, in the paper's order.
# Differences are single minus multi: positive means that the composition does worse.

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
page = page.only(*studies.composition.order_of_fitting(page.manifest, page.datasets))
study = studies.composition.single_against_multi(
    page.manifest, page.datasets, page.methods, fraction=fraction, iterations=iterations, k=k, seed=seed
)
summary = studies.composition.summary(study.table, ["suppression"])

# %% tags=["remove-input"]
display(pages.common.findings(pages.composition.one_inlp_for_all(study), pages.composition.one_leace_for_all(study)))
display(pages.common.label(page.label))
display(pages.composition.equivalence_table(summary, k=k))
pages.composition.fitting_order(list(page.dataset_titles.values()), study.table)

# %% [markdown]
# ## Fewer iterations of INLP
#
# INLP removes one direction with each iteration. On a region with as few images as here, 35 of them remove all or nearly all that
# the images of the region span, and the composition removes that of every dataset. After 1 and 5 iterations:

# %% tags=["remove-input"]
fewer = studies.composition.by_iterations(
    page.manifest, page.datasets, page.methods, fraction=fraction, iterations=iterations, k=k, seed=seed
)
pages.composition.equivalence_table(fewer, k=k)

# %% [markdown]
# ## The paper's Table IV

# %% tags=["remove-input"]
pages.composition.reported_equivalence_table("tab04")

# %% [markdown]
# ## Every pair

# %% tags=["remove-input", "full-width"]
pages.composition.differences_table(study.table, page.method_titles, k=k)

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
in_the_paper = (fraction, iterations, k) == (0.1, 35, 1)
compared = [studies.verdicts.of_equivalence(study.table)] if in_the_paper else []
pages.verdicts.verdicts_table(*compared, titles=page.method_titles)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "tab04_multi_condition"))
display(pages.common.download(studies.reported.table("tab04"), "tab04_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
