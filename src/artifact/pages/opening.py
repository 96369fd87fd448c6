"""All findings of a run, for the opening page."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
from IPython.display import HTML

from artifact import studies
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry
from artifact.pages import composition, distractors, mixed_database, recall, suppression
from artifact.pages.common import Finding, number
from artifact.pages.scope import Page
from artifact.studies.common import Study

DISTANCES = (25.0, 50.0, 75.0, 100.0, 150.0, 200.0)
"""Minimum distractor distances of Fig. 6b, in metres."""

RATIOS = (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)
"""Distractor-to-query ratios of Fig. 6a."""

FRACTIONS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""Query fitting fractions of Fig. 10."""


@dataclass(frozen=True)
class Collected:
    """All findings of a run with the studies behind them."""

    findings: tuple[Finding, ...]
    recall: pd.DataFrame
    studies: tuple[Study, ...]


def collect(manifest: Manifest, names: Sequence[str], methods: Sequence[str], *, seed: int = 0) -> Collected:
    """Evaluate every claim that the datasets at hand can speak to, in the order of the paper."""
    titles = {method: manifest.method(method).title for method in methods}
    entries = {name: manifest.dataset(name) for name in names}
    measured = studies.recall.recall_table(manifest, names, methods, seed=seed)
    found = [
        recall.distractors_lower_recall(measured.table, titles),
        recall.ranking_changes(measured.table, titles),
        recall.similar_recall_hides_differences(measured.table, titles),
    ]
    used = [measured]
    for findings, more in (
        _distractors(manifest, entries, methods, titles, seed),
        _mixed(manifest, entries, methods, titles, seed),
        _suppression(manifest, names, methods, titles, seed),
    ):
        found += findings
        used += more
    return Collected(tuple(found), measured.table, tuple(used))


def _distractors(
    manifest: Manifest,
    entries: Mapping[str, DatasetEntry],
    methods: Sequence[str],
    titles: Mapping[str, str],
    seed: int,
) -> tuple[list[Finding], list[Study]]:
    """Number, distance and condition of distractors, on the first dataset that has what each needs."""
    found, used = [], []
    metric = next((name for name, entry in entries.items() if entry.threshold.unit == "metres"), None)
    if metric is not None:
        threshold = entries[metric].threshold.value
        distances = [threshold, *(d for d in DISTANCES if d > threshold), float("inf")]
        number = studies.distractors.distractor_number(manifest, metric, methods, RATIOS, seed=seed)
        distance = studies.distractors.distractor_distance(manifest, metric, methods, distances, seed=seed)
        found += [
            distractors.few_distractors_suffice(number.table, titles),
            distractors.near_distractors_hurt_most(distance.table, titles, "metres"),
        ]
        used += [number, distance]
    several = next((name for name, entry in entries.items() if entry.distractor_traversals), None)
    if several is not None:
        condition = studies.distractors.distractor_condition(manifest, several, methods, seed=seed)
        entry = entries[several]
        conditions = [entry.traversals[name].condition for name in (entry.query, entry.database)]
        found += [
            distractors.own_condition_hurts_most(condition.table, titles, *conditions),
            distractors.database_condition_hurts_little(condition.table, titles, *conditions),
        ]
        used.append(condition)
    return found, used


def _mixed(
    manifest: Manifest,
    entries: Mapping[str, DatasetEntry],
    methods: Sequence[str],
    titles: Mapping[str, str],
    seed: int,
) -> tuple[list[Finding], list[Study]]:
    """Figs. 2 and 9, on the first dataset with a further traversal of the query's kind of condition."""
    name = next((name for name, entry in entries.items() if entry.same_condition_traversal), None)
    if name is None:
        return [], []
    mixed = {m: studies.mixed_database.mixed_database(manifest, name, m, seed=seed) for m in methods}
    suppressed = {m: studies.mixed_database.mixed_database_suppressed(manifest, name, m, seed=seed) for m in methods}
    inputs = tuple(record for one in mixed.values() for record in one.described.inputs)
    return [
        mixed_database.few_images_lower_recall(mixed, titles),
        mixed_database.suppression_helps_mixed_database(suppressed, titles),
    ], [Study(pd.DataFrame(), inputs)]


def _suppression(
    manifest: Manifest, names: Sequence[str], methods: Sequence[str], titles: Mapping[str, str], seed: int
) -> tuple[list[Finding], list[Study]]:
    """Figs. 8 and 10, Tables IV and V."""
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
    used = [changes, multi]
    if len(irrelevant.table):
        summary = studies.composition.summary(irrelevant.table, ["suppression", "pair"])
        found.append(composition.irrelevant_conditions_unharmed(summary))
        used.append(irrelevant)
    found.append(suppression.a_tenth_suffices(studies.suppression.mean_by_fraction(fractions.table)))
    return found, [*used, fractions]


def scope_notice(page: Page) -> HTML:
    """Say in a box what this build was measured on, and that it is not the paper's data where it is not."""
    kinds = {page.manifest.method(name).kind for name in page.methods}
    reported = [n for n in page.datasets if page.manifest.datasets.get(n) and page.manifest.datasets[n].reported_as]
    comparable = "paper" in kinds and reported
    note = (
        "Numbers are compared with the paper's where dataset and method are the same."
        if comparable
        else "None of these numbers can be compared with the paper's one by one: no method of the paper is among them. "
        "They show whether its claims hold elsewhere."
    )
    return HTML(
        f'<div class="admonition note"><p class="admonition-title">What this build shows</p><p>{html.escape(page.label)} {note}</p></div>'
    )


def headline(frame: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
    """Show the clearest real case of the run in one sentence with its numbers."""
    candidates = frame[frame["origin"].str.startswith("real")]
    chosen = candidates if len(candidates) else frame
    row = chosen.loc[(chosen["R"] - chosen["DAR"]).idxmax()]
    return HTML(
        f'<p class="headline"><span class="big">{number(row["R"])} % → {number(row["DAR"])} %</span> '
        f"R@1 → DAR@1 of {html.escape(titles[row['method']])} on {html.escape(row['title'])} ({html.escape(row['origin'])}, "
        f"{row['queries']} queries): of {row['hits_R']} queries that find their place among the database images alone, "
        f"{row['hits_DAR']} still find it once images of other places under their own condition are added.</p>"
    )
