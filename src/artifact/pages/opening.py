"""All findings of a run, for the opening page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd
from IPython.display import HTML

from artifact import studies
from artifact.pages import composition, distractors, mixed_database, recall, suppression
from artifact.pages.common import Finding, markup, number
from artifact.pages.scope import NothingToShowError, Page
from artifact.studies.common import Study
from artifact.studies.verdicts import DISTANCES, FRACTIONS, RATIOS


@dataclass(frozen=True)
class Collected:
    """All findings of a run with the studies behind them."""

    findings: tuple[Finding, ...]
    recall: pd.DataFrame
    studies: tuple[Study, ...]


def collect(page: Page, *, seed: int = 0) -> Collected:
    """Evaluate every claim that the datasets at hand can speak to, in the order of the paper."""
    titles = page.method_titles
    measured = studies.recall.recall_table(page.manifest, page.datasets, page.methods, seed=seed)
    found = [
        recall.distractors_lower_recall(measured.table, titles),
        recall.ranking_changes(measured.table, titles),
        recall.similar_recall_hides_differences(measured.table, titles),
    ]
    used = [measured]
    for part, needs in (
        (_number_and_distance, {"unit": "metres"}),
        (_condition, {"distractor_traversals": True}),
        (_mixed, {"same_condition_traversal": True}),
        (_suppression, None),
    ):
        try:
            findings, more = part(page if needs is None else page.choose(**needs), seed)
        except NothingToShowError:
            continue
        found += findings
        used += more
    return Collected(tuple(found), measured.table, tuple(used))


def _number_and_distance(page: Page, seed: int) -> tuple[list[Finding], list[Study]]:
    """Fig. 6, on the first dataset with a threshold in metres."""
    threshold = page.manifest.dataset(page.dataset).threshold.value
    distances = [threshold, *(d for d in DISTANCES if d > threshold), float("inf")]
    what = page.manifest, page.dataset, page.methods
    number = studies.distractors.distractor_number(*what, RATIOS, seed=seed)
    distance = studies.distractors.distractor_distance(*what, distances, seed=seed)
    return [
        distractors.few_distractors_suffice(number.table, page.method_titles),
        distractors.near_distractors_hurt_most(distance.table, page.method_titles),
    ], [number, distance]


def _condition(page: Page, seed: int) -> tuple[list[Finding], list[Study]]:
    """Fig. 7, on the first dataset with distractor traversals."""
    study = studies.distractors.distractor_condition(page.manifest, page.dataset, page.methods, seed=seed)
    return [
        distractors.own_condition_hurts_most(study.table, page.method_titles, page.conditions),
        distractors.database_condition_hurts_little(study.table, page.conditions),
    ], [study]


def _mixed(page: Page, seed: int) -> tuple[list[Finding], list[Study]]:
    """Figs. 2 and 9, on the first dataset with a further traversal of the query's kind of condition."""
    mixed, suppressed = (
        {method: study(page.manifest, page.dataset, method, seed=seed) for method in page.methods}
        for study in (studies.mixed_database.mixed_database, studies.mixed_database.mixed_database_suppressed)
    )
    inputs = tuple(record for one in mixed.values() for record in one.inputs)
    return [
        mixed_database.few_images_lower_recall(mixed, page.method_titles),
        mixed_database.suppression_helps_mixed_database(suppressed, page.method_titles),
    ], [Study(pd.DataFrame(), inputs)]


def _suppression(page: Page, seed: int) -> tuple[list[Finding], list[Study]]:
    """Figs. 8 and 10, Tables IV and V."""
    manifest, names, methods, titles = page.manifest, page.datasets, page.methods, page.method_titles
    order = studies.composition.order_of_fitting(manifest, names)
    changes = studies.suppression.suppression_table(manifest, names, methods, seed=seed)
    multi = studies.composition.single_against_multi(manifest, order, methods, seed=seed)
    irrelevant = studies.composition.irrelevant_conditions(manifest, order, methods, seed=seed)
    fractions = studies.suppression.fitting_fraction(manifest, names, methods, FRACTIONS, seed=seed)
    found = [
        suppression.labels_less_accessible(changes.table),
        suppression.suppression_raises_dar(changes.table, titles),
        suppression.suppression_keeps_recall(changes.table, titles),
        composition.one_transform_for_all(studies.composition.summary(multi.table, ["suppression"])),
    ]
    if len(irrelevant.table):
        summary = studies.composition.summary(irrelevant.table, ["suppression", "pair"])
        found.append(composition.irrelevant_conditions_unharmed(summary))
    found.append(suppression.a_tenth_suffices(studies.suppression.mean_by_fraction(fractions.table)))
    return found, [changes, multi, irrelevant, fractions]


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


def headline(frame: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
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
