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
# # Fig. 6: how many distractors, and how near
#
# (a) DAR when only a share of the distractor pool is used. (b) DAR when only distractors farther than a minimum
# distance are used. Both start or end at recall without distractors.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first dataset of the profile whose threshold is in metres
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
ratios: list[float] = [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1]  # of the distractors, each 0 to 1
distances: list[float] = [25, 50, 75, 100, 150, 200]  # metres, from 0; infinity is always added
draws: int = 20  # random draws of distractors in (a), from 1; two-stage methods are averaged over them
k: int = 1  # K of R@K and DAR@K, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(
    profile, dataset=dataset, methods=methods, ratios=ratios, distances=distances, draws=draws, k=k, seed=seed
)
names, page = page.datasets, page.choose(unit="metres")
number = studies.distractors.distractor_number(
    page.manifest, page.dataset, page.methods, ratios, k=k, draws=draws, seed=seed
)
distance = studies.distractors.distractor_distance(
    page.manifest, page.dataset, page.methods, [*distances, float("inf")], k=k, seed=seed
)
everywhere = studies.distractors.by_distance_everywhere(page.manifest, names, page.methods, distances, k=k, seed=seed)

# %% tags=["remove-input"]
display(
    pages.common.findings(
        pages.distractors.few_distractors_suffice(number, page.method_titles, k),
        pages.distractors.more_distractors_hurt_more(number, page.method_titles, k),
        pages.distractors.near_distractors_hurt_most(everywhere, page.method_titles, k),
        pages.distractors.far_distractors_still_hurt(everywhere, page.method_titles, k),
    )
)
display(pages.common.label(page.label))
pages.distractors.number_and_distance(number.table, distance.table, page.method_titles, k=k)

# %% tags=["remove-input"]
pages.common.paragraph(pages.distractors.about_draws(number.table, page.method_titles))

# %% [markdown]
# ## Distance on every dataset in metres
#
# A wider interval of distances removes more distractors, so the gain is also given for each distractor that a query loses.

# %% tags=["remove-input"]
pages.distractors.gains_table(everywhere, page.method_titles, k=k)

# %% [markdown]
# ## The paper's Fig. 6
#
# Drawn from the values that the paper plots for RobotCar, not from this run.

# %% tags=["remove-input"]
pages.distractors.reported_number_and_distance()

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
title = page.dataset_titles[page.dataset]
pages.verdicts.verdicts_table(
    studies.verdicts.of_curve(number.table, "Fig. 6a", title, "ratio"),
    studies.verdicts.of_curve(distance.table, "Fig. 6b", title, "distance", " m"),
    titles=page.method_titles,
)

# %% tags=["remove-input"]
display(pages.common.download(number.table, "fig06a_number"))
display(pages.common.download(everywhere.table, "fig06b_distance"))
display(
    pages.common.download(studies.reported.table("fig06_number"), "fig06_number_reported", "what the paper reports")
)
display(
    pages.common.download(studies.reported.table("fig06_distance"), "fig06_distance_reported", "what the paper reports")
)
pages.provenance.provenance(page, number, everywhere)
