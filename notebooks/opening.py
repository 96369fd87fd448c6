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
# # Are places recognised, or conditions?
#
# Visual place recognition (VPR) is usually tested with queries from one condition against a database from another: day
# against night, summer against winter. A map that many people contribute to holds both. Then an image of *another*
# place under the *query's* condition can look more like the query than the right place does: a **distractor**. The
# paper behind this book, *Are Visual Place Recognition Models Recognizing Places or Conditions? Distractor-Augmented
# Evaluation and Condition Suppression* {cite:p}`kim2026places`, measures that with **Distractor-Augmented Recall**
# (DAR) and the **Recall Survival Rate** (RSR), over eleven methods and six datasets, and takes condition out of descriptors with
# {term}`INLP`, {term}`LEACE` and {term}`STD`. [Words and measures](../glossary.md) has every term.
#
# This book recomputes its tables and figures from data. Every page shows what the paper claims, what *this run*
# measured on which images with which methods, and whether the two agree.

# %% tags=["parameters", "hide-input"]
profile: str = "demo"  # a profile of data_manifest.yaml: demo, paper or rehearsal
datasets: list[str] = None  # names or folders, one or several with commas; None takes all of the profile
methods: list[str] = None  # names, one or several with commas; None takes all of the profile
fractions: list[float] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5]  # of Fig. 10, each 0 to 1
seed: int = 0  # of all random choices, from 0

# %% tags=["hide-input"]
from IPython.display import display

from artifact import pages
from artifact.pages.scope import open_page

page = open_page(profile, datasets=datasets, methods=methods, fractions=fractions, seed=seed)
collected = pages.opening.collect(page, fractions, seed=seed)

# %% tags=["remove-input"]
display(pages.opening.scope_notice(page))
display(pages.opening.tally(collected.findings))
display(pages.opening.headline(collected.recall, page.method_titles))

# %% [markdown]
# ## What was claimed, what was measured, and whether they agree

# %% tags=["remove-input", "full-width"]
pages.common.findings_table(collected.findings)

# %% [markdown]
# *Agrees* means that the claim holds on the data and methods of this run, beyond chance, by the rule that the linked page
# states; *differs* that its contrary does; *cannot tell* that the run is too small to say, and how much too small. All
# intervals are block-bootstrap intervals along the traversal. None of it means that the paper's numbers were reproduced: that
# needs the paper's datasets and weights (profile `paper`), and each page then compares number with number (there *equal* is
# the fourth verdict). [How sure](how_sure.ipynb) shows which methods can be told apart at all.
#
# ## The paper
#
# Beomsu Kim, Minwoo Jung, Giseop Kim: *Are Visual Place Recognition Models Recognizing Places or Conditions?
# Distractor-Augmented Evaluation and Condition Suppression*, 2026, [arXiv:2608.06847](https://doi.org/10.48550/arXiv.2608.06847).
#
# ```bibtex
# @misc{kim2026places,
#   author = {Kim, Beomsu and Jung, Minwoo and Kim, Giseop},
#   title = {Are Visual Place Recognition Models Recognizing Places or Conditions?
#            Distractor-Augmented Evaluation and Condition Suppression},
#   year = {2026},
#   eprint = {2608.06847},
#   archivePrefix = {arXiv}
# }
# ```
#
# ## How to read on
#
# - [Fig. 1](fig01.ipynb) shows what a distractor is, [Fig. 2](fig02.ipynb) what a few of them do to a map.
# - [Table III](tab03.ipynb) is the main result, [Figs. 5](fig05.ipynb), [6](fig06.ipynb) and [7](fig07.ipynb) take it
#   apart; [Fig. 4](fig04.ipynb) has the definitions.
# - [Fig. 8](fig08.ipynb) is the main result on suppression, [Fig. 9](fig09.ipynb) shows it on a mixed database,
#   [Table IV](tab04.ipynb), [Table V](tab05.ipynb) and [Fig. 10](fig10.ipynb) ask how far it carries.
# - [How sure](how_sure.ipynb) is the order of the methods, and [Taken](taken.ipynb) shows the queries that distractors take.
# - [Within one session](within_session.ipynb) and [What is erased](erased.ipynb) go beyond the paper.
# - [Methods](methods.ipynb) says which of the paper's eleven methods are here and how they are held to their authors' models.
# - [The City](city.ipynb) is the rendered town that lets all of this run on any machine with no download.
# - [Protocol](protocol.ipynb) lists every choice that the paper leaves open, with our default and what it changes.
# - [Full run](full_run.ipynb) says what the whole paper takes, method by method.
# - [A new dataset or method](../new.md) shows how to put your own images in, and [Status](status.md) says what ran, when and
#   on which machine.

# %% tags=["remove-input"]
pages.provenance.provenance(page, *collected.studies)
