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
# # Fig. 1: what a distractor is
#
# A map that many people contribute to can hold the query's place under *another* condition and another place under the
# *query's* condition. If descriptors tell conditions apart, the second can be the more similar image. One query of this
# run, with the cosine similarities that the method gave:

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes one with images at hand, in metres if there is one
method: str = None  # a name; None takes the last method of the profile
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages
from artifact.pages import galleries
from artifact.pages.scope import open_page
from artifact.studies import evaluated

page = open_page(profile, dataset=dataset, method=method, seed=seed)
page = page.choose(images=True, prefer="metres")
measured = evaluated.evaluation(page.manifest, page.dataset, page.method, retrieve=1, seed=seed)
result = measured.evaluation
taken = int((result.hits(1, distractors=False) & ~result.hits(1, distractors=True)).sum())

# %% tags=["remove-input"]
display(pages.common.label(page.label))
galleries.distractor_story(measured)

# %% tags=["remove-input"]
right = f"queries that {page.method_titles[page.method]} places rightly on {measured.dataset.title}"
number = int(result.hits(1, distractors=False).sum())
pages.common.paragraph(
    f"It is not an exception: distractors take {taken} of the {number} {right}. The query shown is the one with the median "
    f"margin. More of them, spread evenly over the traversal:"
    if taken
    else f"Distractors take none of the {number} {right}; the queries shown are spread evenly over the traversal."
)

# %% tags=["remove-input"]
galleries.retrieval_strips(measured, n=4)

# %% [markdown]
# The paper calls the effect *condition bias*: the descriptor answers "under which condition?" before "where?".
# [Fig. 4](fig04.ipynb) turns it into a measure, [Table III](tab03.ipynb) measures it.

# %% tags=["remove-input"]
pages.provenance.provenance(page, measured)
