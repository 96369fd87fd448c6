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
# # Fig. 2: a few images of the query's condition
#
# Left: the database holds the other condition only. Right: a few frames of a further traversal, under the query's kind of
# condition, join it. Each line joins a query with its top-1 retrieval. Recall counts every database image within the
# threshold as right, the added ones too, so the added images could only help a method that recognises places.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first with a traversal of the query's kind of condition
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
share: float = 0.05  # of the frames of that traversal: 0 to 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(profile, dataset=dataset, methods=methods, share=share, seed=seed)
page = page.choose(same_condition_traversal=True).single_stage()
found = {
    method: studies.mixed_database.mixed_database(page.manifest, page.dataset, method, share=share, seed=seed)
    for method in page.methods
}

# %% tags=["remove-input", "full-width"]
display(pages.common.findings(pages.mixed_database.few_images_lower_recall(found, page.method_titles, seed)))
display(pages.common.label(page.label))
panels = {"single": "single-condition database", "mixed": "mixed-condition database"}
pages.mixed_database.mixed_database(found, panels, page.mixed_conditions, page.method_titles)

# %% [markdown]
# ## Beside the paper's Fig. 2
#
# The paper draws AnyLoc and EigenPlaces on RobotCar. Which frames are added matters: they are drawn at random, twenty
# times; the maps show the first draw, the numbers are means over all.

# %% tags=["remove-input"]
table = pages.mixed_database.mixed_table(found, panels, page.method_titles)
display(table)
display(pages.mixed_database.reported_mixed_table("fig02"))

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
recall = studies.mixed_database.mixed_recall(page.manifest, page.dataset, found, "fig02", seed=seed)
pages.verdicts.verdicts_table(
    studies.verdicts.of_mixed_database(recall, "Fig. 2", page.dataset_titles[page.dataset]), titles=page.method_titles
)

# %% tags=["remove-input"]
display(pages.common.download(studies.mixed_database.mixed_table(found), "fig02_mixed_database"))
display(pages.common.download(studies.reported.table("fig02"), "fig02_reported", "what the paper reports"))
pages.provenance.provenance(page, *found.values())
