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
# # What is erased
#
# *Beyond the paper*: a closer look at one dataset and one method. Where do similarities move, how does DAR change with every
# INLP iteration, and which distractors stop winning? Fitted on 10 % of the queries around the centre, shown on the rest.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
dataset: str = None  # a name or a folder; None takes the first with real images, else the first
method: str = None  # a name; None takes the last method of the profile that does not re-rank
fraction: float = 0.1  # of the queries, for fitting: 0 to 1
iterations: int = 35  # of INLP, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
import contextlib

from IPython.display import Markdown, display

from artifact import pages, studies
from artifact.pages import galleries
from artifact.pages.scope import NothingToShowError, open_page

opened = open_page(profile, dataset=dataset, method=method, fraction=fraction, iterations=iterations, seed=seed)
page = opened.choose(prefer="real", single_stage=True)
fitting = {"fraction": fraction, "iterations": iterations, "seed": seed}
erased = studies.erased.what_is_erased(page.manifest, page.dataset, page.method, **fitting)
# Descriptors that come without images have no strips: then those of the first dataset that has images.
strips = erased
if not erased.described.dataset.query.has_images:
    with contextlib.suppress(NothingToShowError):
        pictured = opened.choose(images=True, single_stage=True).dataset
        strips = studies.erased.what_is_erased(page.manifest, pictured, page.method, **fitting)

# %% tags=["remove-input"]
display(pages.common.label(page.label))
pages.erased.erased_table(erased)

# %% [markdown]
# ## Similarities
#
# A distractor wins when a blue pair is more similar than the query's green pairs. Dotted lines are medians.

# %% tags=["remove-input", "full-width"]
pages.erased.similarities(erased.similarities, ["original", "LEACE", "INLP"])

# %% tags=["remove-input"]
Markdown(pages.erased.erased_similarities(erased))

# %% [markdown]
# ## Iteration by iteration
#
# INLP removes one direction at a time. The gray curve is the balanced accuracy, on the fitting data, of the classifier that the
# next iteration fits: at 50 % it finds nothing more to remove.

# %% tags=["remove-input"]
pages.erased.iterations(erased.iterations)

# %% [markdown]
# ## Distractors that stop winning

# %% tags=["remove-input"]
lost, recovered = strips.lost_and_recovered("LEACE")
display(
    Markdown(
        f"On {pages.common.plain(strips.described.dataset.title)}, distractors take {len(lost)} queries from the original descriptors; LEACE gives {len(recovered)} of them back. "
        f"Some of those, spread evenly:"
    )
)
galleries.recovered_strips(strips, "LEACE")

# %% tags=["remove-input"]
display(pages.common.download(erased.iterations, "erased_iterations"))
pages.provenance.provenance(page, erased.described, strips.described)
