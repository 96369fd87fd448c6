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
# # Fig. 4: recall and distractor-augmented recall
#
# Drawn by code from no data. A robot at the query pose retrieves from the database. The dashed circle is
# the positive threshold. For recall (a), the database holds only images of the other condition. For DAR (b), each
# query's database gains images of the query's own condition, all of them outside its circle: none of them can be
# correct, and some of them may look more like the query than the correct images do.

# %% tags=["parameters", "hide-input"]
# This page has no parameters.

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages
from artifact.pages.style import page_style, use_style

use_style()
display(page_style())

# %% tags=["remove-input"]
pages.diagram.retrieval_diagram()

# %% [markdown]
# ## Definitions
#
# For query $q_i$ at position $y_i$, with cross-condition database $\mathcal C$, distractor pool $\mathcal D$ and
# threshold $d_\mathrm{thr}$:
#
# $$
# \begin{aligned}
# \mathcal P_i &= \{c_j \in \mathcal C : \lVert y_i - y_j^{\mathcal C}\rVert_2 \le d_\mathrm{thr}\}, \\
# \mathcal N_i &= \{d_l \in \mathcal D : \lVert y_i - y_l^{\mathcal D}\rVert_2 > d_\mathrm{thr}\}, \\
# \mathcal A_i &= \mathcal C \cup \mathcal N_i .
# \end{aligned}
# $$
#
# R@K is the share of queries with an image of $\mathcal P_i$ among the top K of $\mathcal C$, DAR@K the share with one
# among the top K of $\mathcal A_i$, and RSR@K = DAR@K / R@K.
#
# ## Why counting is enough
#
# Let $s_i$ be the similarity of the best positive, $b_i$ the number of database images above it and $n_i$ the number of
# allowed distractors above it. Then R@K is the mean of $[b_i < K]$ and DAR@K the mean of $[b_i + n_i < K]$, for every K
# at once. Nothing is sorted and no per-query database is built, which is how this artifact evaluates all sweeps from
# one pass; the tests compare it with a literal sort of $\mathcal A_i$ on thousands of small cases with ties.
