"""Claims on mixed databases and on condition suppression (paper §I, V-D to V-F)."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from artifact.findings.finding import Finding
from artifact.studies.mixed_database import MixedDatabase
from artifact.studies.suppression import improved

NO_LOSS_PP = 1.1
"""Largest fall of R@1 that the paper still calls preserved (§V-D), in percentage points."""

MOSTLY = 0.8
"""Share of pairs within 1 percentage point that counts as "preserved"; the paper's own shares are 46/54 to 9/9."""


def few_images_lower_recall(found: Mapping[str, MixedDatabase], titles: Mapping[str, str]) -> Finding:
    """A few images of the query's condition in the database lower R@1 (Fig. 2)."""
    changes = {
        m: (100 * one.evaluations["single"].recall(1), 100 * one.evaluations["mixed"].recall(1))
        for m, one in found.items()
    }
    falls = [m for m, (alone, mixed) in changes.items() if mixed < alone]
    worst = min(changes, key=lambda m: changes[m][1] - changes[m][0])
    before, after = changes[worst]
    added = len(next(iter(found.values())).added)
    return Finding(
        "fig02",
        "A few images of the query's kind of condition in the database can lower R@1, though some of them show the place.",
        "5 % of a day traversal lower R@1 on RobotCar from 95.9 % to 80.5 % (AnyLoc), from 91.5 % to 86.8 % (EigenPlaces)",
        f"some method loses more than {NO_LOSS_PP:g} pp",
        f"{added} added images lower R@1 for {len(falls)} of {len(changes)} methods; {titles[worst]} goes from "
        f"{before:.1f} % to {after:.1f} %",
        before - after > NO_LOSS_PP,
    )


def labels_less_accessible(table: pd.DataFrame) -> Finding:
    """INLP and LEACE make conditions less accessible to a linear classifier than STD does (Fig. 8a)."""
    counts = improved(table).set_index("suppression")
    return Finding(
        "fig08",
        "After INLP and LEACE a linear classifier tells the conditions apart less well; STD helps less often.",
        "probe accuracy falls for 50 (INLP), 52 (LEACE) and 27 (STD) of 54 method–dataset pairs",
        "INLP and LEACE each help more than half of the pairs, and more than STD does",
        f"probe accuracy falls for {_counted(counts, 'probe')} of {counts['pairs'].iloc[0]} pairs",
        _both_mostly(counts, "probe"),
    )


def suppression_raises_dar(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """INLP and LEACE raise DAR for most pairs, STD for fewer (Fig. 8b)."""
    counts = improved(table).set_index("suppression")
    best = table.loc[table["change_DAR"].idxmax()]
    return Finding(
        "fig08",
        f"INLP and LEACE raise DAR@{k} for most method–dataset pairs, STD for fewer.",
        "DAR@1 rises for 46 (INLP), 47 (LEACE) and 18 (STD) of 54 pairs; most: AnyLoc on RobotCar, +37 pp with INLP",
        "INLP and LEACE each help more than half of the pairs, and more than STD does",
        f"DAR@{k} rises for {_counted(counts, 'DAR')} of {counts['pairs'].iloc[0]} pairs; most: {titles[best['method']]} on "
        f"{best['title']}, {best['change_DAR']:+.1f} pp with {best['suppression']}",
        _both_mostly(counts, "DAR"),
    )


def suppression_keeps_recall(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Suppression keeps R without distractors, except for STD (Fig. 8c)."""
    changed = table[table["suppression"].isin(["INLP", "LEACE"])]
    falls = changed[changed["change_R"] < -NO_LOSS_PP - 1e-9]
    worst = changed.loc[changed["change_R"].idxmin()]
    return Finding(
        "fig08",
        f"INLP and LEACE leave R@{k} without distractors intact.",
        "R@1 falls by at most 1.1 pp, except for STD with AnyLoc on StLuciaMToD (8.2 pp)",
        f"no pair loses more than {NO_LOSS_PP:g} pp",
        f"R@{k} falls by more than {NO_LOSS_PP:g} pp for {len(falls)} of {len(changed)} combinations of INLP or LEACE with a pair; "
        f"largest change down: {titles[worst['method']]} on {worst['title']}, {worst['change_R']:+.1f} pp with {worst['suppression']}",
        bool(falls.empty),
    )


def suppression_helps_mixed_database(found: Mapping[str, MixedDatabase], titles: Mapping[str, str]) -> Finding:
    """INLP raises R@1 on a mixed database, with a fit on another part of the map (Fig. 9)."""
    changes = {
        m: (100 * one.evaluations["original"].recall(1), 100 * one.evaluations["INLP"].recall(1))
        for m, one in found.items()
    }
    rises = [m for m, (before, after) in changes.items() if after > before]
    listed = ", ".join(f"{titles[m]} {before:.1f} % to {after:.1f} %" for m, (before, after) in changes.items())
    return Finding(
        "fig09",
        "INLP, fitted on one end of the map, raises R@1 on a mixed database elsewhere.",
        "on RobotCar from 80.4 % to 96.8 % (AnyLoc) and from 88.7 % to 93.8 % (EigenPlaces)",
        "R@1 rises for every method",
        f"R@1 rises for {len(rises)} of {len(changes)} methods: {listed}",
        len(rises) == len(changes),
    )


def one_transform_for_all(summary: pd.DataFrame) -> Finding:
    """The composition of all transforms does as well as each dataset's own (Table IV)."""
    return Finding(
        "tab04",
        "One composed transform does as well as a transform for each dataset.",
        "46 to 52 of 54 pairs stay within 1 pp; mean differences are at most 0.25 pp",
        f"at least {MOSTLY:.0%} of the pairs stay within 1 pp, in DAR and R, with INLP and LEACE",
        _within(summary, ["suppression"]),
        bool((_shares(summary) >= MOSTLY).to_numpy().all()),
    )


def irrelevant_conditions_unharmed(summary: pd.DataFrame) -> Finding:
    """The composed transform does no harm to condition pairs that it was not fitted on (Table V)."""
    lost = summary[["mean_DAR", "mean_R"]].max().max()
    return Finding(
        "tab05",
        "The composed transform does no harm to condition pairs that it was not fitted on.",
        "8 or 9 of 9 methods stay within 1 pp on two pairs; mean differences are at most 0.34 pp",
        f"at least {MOSTLY:.0%} of the methods stay within 1 pp on every pair, in DAR and R, with INLP and LEACE",
        f"{_within(summary, ['suppression', 'pair'])}; largest mean loss {max(lost, 0):.1f} pp",
        bool((_shares(summary) >= MOSTLY).to_numpy().all()),
    )


def a_tenth_suffices(means: pd.DataFrame, k: int = 1) -> Finding:
    """A tenth of the queries suffices to fit without losing mean R; STD needs more data (Fig. 10)."""
    wide = means.pivot_table(index="fraction", columns="suppression", values=["change_DAR", "change_R"])
    rule = f"at 10 % no mean ΔR@{k} is negative, and the mean ΔDAR@{k} of STD is the smallest"
    tenth = wide.loc[0.1] if 0.1 in wide.index else None
    claim = f"Fitting on 10 % of the queries lowers the mean R@{k} of no suppression method; STD gains least DAR@{k}."
    reported = (
        "at 10 %, mean R@1 rises for all three; mean DAR@1 changes by +4.2 (INLP), +3.7 (LEACE) and −1.9 pp (STD)"
    )
    if tenth is None:
        return Finding("fig10", claim, reported, rule, "the fraction 0.1 is not among the parameters", None)
    recall, dar = tenth["change_R"], tenth["change_DAR"]

    def listed(values: pd.Series) -> str:
        return ", ".join(f"{name} {values[name]:+.1f}" for name in ("INLP", "LEACE", "STD"))

    return Finding(
        "fig10",
        claim,
        reported,
        rule,
        f"at 10 %, mean ΔR@{k} is {listed(recall)} pp and mean ΔDAR@{k} {listed(dar)} pp",
        bool((recall >= 0).all() and dar["STD"] == dar.min()),
    )


def _counted(counts: pd.DataFrame, column: str) -> str:
    parts = [f"{counts.loc[name, column]} ({name})" for name in counts.index]
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def _both_mostly(counts: pd.DataFrame, column: str) -> bool:
    """INLP and LEACE help more than half of the pairs, and each more than STD."""
    both = counts.loc[["INLP", "LEACE"], column]
    return bool((both > counts["pairs"].iloc[0] / 2).all() and (both > counts.loc["STD", column]).all())


def _shares(summary: pd.DataFrame) -> pd.DataFrame:
    return summary[["within_DAR", "within_R"]].div(summary["pairs"], axis=0)


def _within(summary: pd.DataFrame, by: list[str]) -> str:
    rows = [
        f"{' '.join(row[column] for column in by)}: DAR@1 {row['within_DAR']}, R@1 {row['within_R']} of {row['pairs']}"
        for row in summary.to_dict("records")
    ]
    return f"within 1 pp: {'; '.join(rows)}"
