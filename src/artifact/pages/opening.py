"""All findings of a run, for the opening page."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd
from IPython.display import HTML

from artifact import studies
from artifact.extraction.described import Described
from artifact.pages import composition, distractors, embedding, mixed_database, recall, suppression
from artifact.pages.common import PAGES, Finding, Titles, markup, number
from artifact.pages.common import tally as in_words
from artifact.pages.scope import NothingToShowError, Page
from artifact.studies.common import Study
from artifact.studies.mixed_database import MixedDatabase
from artifact.studies.verdicts import DISTANCES, RATIOS


@dataclass(frozen=True)
class Collected:
    """All findings of a run with the studies behind them."""

    findings: tuple[Finding, ...]
    recall: pd.DataFrame
    studies: tuple[Study | MixedDatabase | Described, ...]


def collect(page: Page, fractions: Sequence[float], *, seed: int = 0) -> Collected:
    """Evaluate every claim that the datasets at hand can speak to, in the order of the paper.

    Claims on suppression take the single-stage methods; ``fractions`` are those of Fig. 10, the seed is that of all
    choices.
    """
    titles = page.method_titles
    measured = studies.recall.recall_table(page.manifest, page.datasets, page.methods, seed=seed)
    found = [
        recall.distractors_lower_recall(measured, titles),
        recall.ranking_changes(measured, titles),
        recall.mean_ranking_changes(measured, titles),
        recall.similar_recall_hides_differences(measured, titles),
    ]
    used: list[Study | MixedDatabase | Described] = [measured]
    suppression_of = functools.partial(_suppression, fractions=fractions)
    for part in (_number_and_distance, _condition, _mixed, _embedding, suppression_of):
        with contextlib.suppress(NothingToShowError):
            findings, more = part(page, seed)
            found += findings
            used += more
    order = list(PAGES)
    return Collected(tuple(sorted(found, key=lambda one: order.index(one.page))), measured.table, tuple(used))


def _number_and_distance(page: Page, seed: int) -> tuple[list[Finding], list[Study]]:
    """Fig. 6: (a) on the first dataset with a threshold in metres, (b) on all of them."""
    manifest, methods, titles = page.manifest, page.methods, page.method_titles
    first = page.choose(unit="metres").dataset
    number = studies.distractors.distractor_number(manifest, first, methods, RATIOS, seed=seed)
    distance = studies.distractors.by_distance_everywhere(manifest, page.datasets, methods, DISTANCES, seed=seed)
    return [
        distractors.few_distractors_suffice(number, titles),
        distractors.more_distractors_hurt_more(number, titles),
        distractors.near_distractors_hurt_most(distance, titles),
        distractors.far_distractors_still_hurt(distance, titles),
    ], [number, distance]


def _condition(page: Page, seed: int) -> tuple[list[Finding], list[Study]]:
    """Fig. 7, on the first dataset with distractor traversals."""
    page = page.choose(distractor_traversals=True)
    study = studies.distractors.distractor_condition(page.manifest, page.dataset, page.methods, seed=seed)
    return [
        distractors.own_condition_hurts_most(study, page.method_titles, page.conditions),
        distractors.conditions_between_hurt_less(study, page.conditions),
        distractors.database_condition_hurts_little(study, page.conditions),
    ], [study]


def _mixed(page: Page, seed: int) -> tuple[list[Finding], list[MixedDatabase]]:
    """Figs. 2 and 9, on the first dataset with a further traversal of the query's kind of condition."""
    page = page.choose(same_condition_traversal=True).single_stage()
    mixed, suppressed = (
        {method: study(page.manifest, page.dataset, method, seed=seed) for method in page.methods}
        for study in (studies.mixed_database.mixed_database, studies.mixed_database.mixed_database_suppressed)
    )
    return [
        mixed_database.few_images_lower_recall(mixed, page.method_titles, seed),
        mixed_database.suppression_helps_mixed_database(suppressed, page.method_titles, seed),
    ], list(mixed.values())


def _embedding(page: Page, seed: int) -> tuple[list[Finding], list[Described]]:
    """Fig. 3, on a dataset with a threshold in metres if there is one."""
    page = page.single_stage().choose(prefer="metres")
    one = studies.embedding.embedding(page.manifest, page.dataset, page.methods[-1], seed=seed)
    found = [embedding.suppression_mixes_conditions(one, seed), embedding.suppression_aligns_places(one, seed)]
    return found, [one.described]


def _suppression(page: Page, seed: int, *, fractions: Sequence[float]) -> tuple[list[Finding], list[Study]]:
    """Figs. 8 and 10, Tables IV and V."""
    page = page.single_stage()
    manifest, names, methods = page.manifest, page.datasets, page.methods
    order = studies.composition.order_of_fitting(manifest, names)
    changes = studies.suppression.suppression_table(manifest, names, methods, seed=seed)
    multi = studies.composition.single_against_multi(manifest, order, methods, seed=seed)
    irrelevant = studies.composition.irrelevant_conditions(manifest, order, methods, seed=seed)
    by_fraction = studies.suppression.fitting_fraction(manifest, names, methods, fractions, seed=seed)
    found = [*suppression.of_changes(changes, page.method_titles), *suppression.of_fractions(by_fraction)]
    found += [composition.one_inlp_for_all(multi), composition.one_leace_for_all(multi)]
    if len(irrelevant.table):
        unharmed = composition.inlp_leaves_others_unharmed, composition.leace_leaves_others_unharmed
        found += [claim(irrelevant) for claim in unharmed]
    return found, [changes, multi, irrelevant, by_fraction]


def tally(found: Sequence[Finding]) -> HTML:
    """Show how many claims agree, differ and cannot be told, as ``make reproduce`` prints it."""
    return markup('<p class="tally">{}</p>', in_words(found))


def scope_notice(page: Page) -> HTML:
    """Say in a box what this build was measured on, and that it is not the paper's data where it is not."""
    of_the_paper = any(page.manifest.method(name).kind == "paper" for name in page.methods)
    comparable = of_the_paper and any(page.manifest.dataset(name).reported_as for name in page.datasets)
    note = (
        "Numbers are compared with the paper's where dataset and method are the same."
        if comparable
        else "None of these numbers can be compared with the paper's one by one: no method of the paper is among them. "
        "They show whether its claims hold elsewhere."
    )
    box = '<div class="admonition note"><p class="admonition-title">What this build shows</p><p>{} {}</p></div>'
    return markup(box, page.label, note)


def headline(frame: pd.DataFrame, titles: Titles) -> HTML:
    """Show the clearest real case of the run in one sentence with its numbers."""
    real = frame[frame["origin"].str.startswith("real")]
    chosen = real if len(real) else frame
    row = chosen.loc[(chosen["R"] - chosen["DAR"]).idxmax()]
    return markup(
        '<p class="headline"><span class="big">{} % → {} %</span> R@1 → DAR@1 of {} on {} ({}, {} queries): of {} queries '
        "that find their place among the database images alone, {} still find it once images of other places under their own "
        "condition are added.</p>",
        *(number(row["R"]), number(row["DAR"]), titles[row["method"]], row["title"], row["origin"]),
        *(row["queries"], row["hits_R"], row["hits_DAR"]),
    )
