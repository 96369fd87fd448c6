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
# # Table V: conditions that nothing was fitted on
#
# A transform that is always applied must do no harm where its conditions do not occur. The composed transform of
# [Table IV](tab04.ipynb) meets pairs of traversals that took no part in any fit. Differences are original minus erased:
# positive means that erasure lowers the result.

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
from artifact.pages.scope import NothingToShowError, open_page

page = open_page(profile, datasets=datasets, methods=methods, fraction=fraction, iterations=iterations, k=k, seed=seed)
page = page.single_stage()
page = page.only(*studies.composition.order_of_fitting(page.manifest, page.datasets))
study = studies.composition.irrelevant_conditions(
    page.manifest, page.datasets, page.methods, fraction=fraction, iterations=iterations, k=k, seed=seed
)
if study.table.empty:
    raise NothingToShowError("this page needs a dataset with the key irrelevant_pairs; none of this run has it")
summary = studies.composition.summary(study.table, ["suppression", "pair"])

# %% tags=["remove-input"]
display(
    pages.common.findings(
        pages.composition.inlp_leaves_others_unharmed(study), pages.composition.leace_leaves_others_unharmed(study)
    )
)
display(pages.common.label(page.label))
display(pages.composition.equivalence_table(summary, k=k))
pages.composition.fitting_order(list(page.dataset_titles.values()), study.table)

# %% [markdown]
# ## The paper's Table V

# %% tags=["remove-input"]
pages.composition.reported_equivalence_table("tab05")

# %% [markdown]
# ## Every method

# %% tags=["remove-input", "full-width"]
pages.composition.differences_table(study.table, page.method_titles, k=k)

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
in_the_paper = (fraction, iterations, k) == (0.1, 35, 1)
compared = [studies.verdicts.of_irrelevant(study.table)] if in_the_paper else []
pages.verdicts.verdicts_table(*compared, titles=page.method_titles)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "tab05_irrelevant_conditions"))
display(pages.common.download(studies.reported.table("tab05"), "tab05_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
