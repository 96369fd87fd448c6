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
# # Fig. 10: how much fitting data is needed
#
# Transforms are fitted on growing shares of the queries around the centre and always evaluated on the same outer half of the
# map. At fraction 0 nothing is suppressed. Means over all pairs that have every fraction.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
fractions: list[float] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5]  # for fitting, each 0 to 1
iterations: int = 35  # of INLP, from 1
k: int = 1  # K of R@K and DAR@K, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import Markdown, display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(
    profile, datasets=datasets, methods=methods, fractions=fractions, iterations=iterations, k=k, seed=seed
)
page = page.single_stage()
study = studies.suppression.fitting_fraction(
    page.manifest, page.datasets, page.methods, fractions, iterations=iterations, k=k, seed=seed
)
means = studies.suppression.mean_by_fraction(study.table)

# %% tags=["remove-input"]
display(pages.common.findings(*pages.suppression.of_fractions(study, k)))
display(pages.common.label(page.label))
display(pages.suppression.fraction_curves(means, k=k))
Markdown(f"Mean over {means['pairs'].min()} method–dataset pairs.")

# %% [markdown]
# ## The paper's Fig. 10
#
# Drawn from the values that the paper plots, means over 54 pairs, not from this run. The vertical axes are those of these values,
# not of the figure above.

# %% tags=["remove-input"]
pages.suppression.reported_fraction_curves()

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
compared = [studies.verdicts.of_fractions(study.table)] if (iterations, k) == (35, 1) else []
pages.verdicts.verdicts_table(*compared, titles=page.method_titles)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "fig10_fitting_fraction"))
display(pages.common.download(studies.reported.table("fig10"), "fig10_reported", "what the paper reports"))
pages.provenance.provenance(page, study)
