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
# # Within one session
#
# *Beyond the paper*, which names this as future work: do incidental conditions inside a single traversal, such as brightness,
# take queries as day and night do, and can they be suppressed?
#
# A statistic of the images splits the query traversal at its median. Every query meets two pools of distractors of the same
# size, both from its own traversal: images on *its own* side of the median, and images on the *other* side. If descriptors
# encode the statistic, the own side takes more queries: the **gap**, R@1 with distractors of the other side minus R@1 with
# distractors of the own side, is positive.
#
# Neighbouring images share brightness *and* look alike for other reasons. The **control** is the same gap with the labels
# turned along the traversal by eight offsets, which keeps how they cluster in space but not what they say about an image. Only
# a gap beyond the control speaks for the statistic. INLP and LEACE are fitted on the labels of a contiguous quarter of the
# queries and evaluated on the rest.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
statistics: list[str] = ["brightness", "contrast"]  # of: brightness, contrast, saturation, sharpness
fraction: float = 0.25  # of the queries, for fitting: 0 to 1
iterations: int = 35  # of INLP, from 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import Markdown, display

from artifact import pages, studies
from artifact.pages.scope import open_page

page = open_page(
    profile,
    datasets=datasets,
    methods=methods,
    statistics=statistics,
    fraction=fraction,
    iterations=iterations,
    seed=seed,
)
page = page.with_statistics().single_stage()
study = studies.within_session.within_session(
    page.manifest, page.datasets, page.methods, statistics, fraction=fraction, iterations=iterations, seed=seed
)

# %% tags=["remove-input", "full-width"]
display(pages.common.label(page.label))
for statistic in statistics:
    rows = study.table[study.table["statistic"] == statistic]
    display(Markdown(f"## {statistic.capitalize()}"))
    display(pages.common.paragraph(pages.within_session.within_summary(rows, page.method_titles)))
    display(pages.within_session.sided_gaps(rows, page.method_titles))

# %% [markdown]
# Dots are gaps with 95 % block-bootstrap intervals, bars the mean gap of the control on the original descriptors.
#
# ## All values

# %% tags=["remove-input", "full-width"]
pages.within_session.within_table(study.table, page.method_titles)

# %% tags=["remove-input"]
display(pages.common.download(study.table, "within_session"))
pages.provenance.provenance(page, study)
