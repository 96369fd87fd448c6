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
# # Fig. 9: suppression on a mixed database
#
# The mixed database of [Fig. 2](fig02.ipynb), before and after INLP. The transform is fitted on a slice at one end of the map
# (gray); its queries and database images take no part in the evaluation. The added images are of another condition than the
# one that INLP was fitted on, so this also asks whether the effect carries over to a similar condition.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first with a traversal of the query's kind of condition
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
share: float = 0.05  # of the frames of the added traversal: 0 to 1
fraction: float = 0.1  # of the queries, for fitting: 0 to 1
iterations: int = 35  # of INLP, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(
    profile, dataset=dataset, methods=methods, share=share, fraction=fraction, iterations=iterations, seed=seed
)
page = page.choose(same_condition_traversal=True).single_stage()
found = {
    method: studies.mixed_database.mixed_database_suppressed(
        page.manifest, page.dataset, method, share=share, fraction=fraction, iterations=iterations, seed=seed
    )
    for method in page.methods
}

# %% tags=["remove-input", "full-width"]
display(pages.common.findings(pages.mixed_database.suppression_helps_mixed_database(found, page.method_titles, seed)))
display(pages.common.label(page.label))
panels = {"original": "original", "INLP": "suppressed with INLP"}
pages.mixed_database.mixed_database(found, panels, page.mixed_conditions, page.method_titles)

# %% [markdown]
# ## Beside the paper's Fig. 9

# %% tags=["remove-input"]
display(pages.mixed_database.mixed_table(found, panels, page.method_titles))
display(pages.mixed_database.reported_mixed_table("fig09"))

# %% [markdown]
# ## Number by number
#
# *Equal*: the same number of queries, or equal to the digits that the paper prints. *Agrees*: the paper's number lies in the
# 95 % interval and within 1 pp. *Differs*: outside both. *Cannot tell*: anything else; the reason stands beside it.

# %% tags=["remove-input", "full-width"]
recall = studies.mixed_database.mixed_recall(page.manifest, page.dataset, found, "fig09", seed=seed)
pages.verdicts.verdicts_table(
    studies.verdicts.of_mixed_database(recall, "Fig. 9", page.dataset_titles[page.dataset]), titles=page.method_titles
)

# %% tags=["remove-input"]
display(pages.common.download(studies.mixed_database.mixed_table(found), "fig09_mixed_database"))
display(pages.common.download(studies.reported.table("fig09"), "fig09_reported", "what the paper reports"))
pages.provenance.provenance(page, *found.values())
