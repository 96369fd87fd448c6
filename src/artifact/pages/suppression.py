"""Figs. 8 and 10: what condition suppression changes, and how much fitting data it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes

from artifact.metrics.statistics import holm, p_values
from artifact.pages.common import NO_LOSS_PP, Answer, Finding, Titles, change, claimed, join, markup, number, table
from artifact.pages.style import SUPPRESSION_COLOURS, SUPPRESSION_MARKERS, drawing, embed, legend_below, tell_values
from artifact.studies import reported
from artifact.studies.common import Study
from artifact.studies.fitted import LOW_RANK
from artifact.studies.fitted import METHODS as SUPPRESSORS
from artifact.studies.judging import CERTAIN, CLOSE_PP, Judged, above, all_above, first_of, more_often, mostly
from artifact.studies.suppression import has_every_fraction, improved

_QUANTITIES = {
    "change_probe": ("(a) Guardedness probe accuracy", "lower is better", "RdBu_r"),
    "change_DAR": ("(b) ΔDAR@K", "higher is better", "RdBu"),
    "change_R": ("(c) ΔR@K", "higher is better", "RdBu"),
}


def improved_table(frame: pd.DataFrame, *, k: int = 1) -> HTML:
    """Show how many method–dataset pairs improve, measured and reported."""
    counts = improved(frame).set_index("suppression")
    expected = reported.table("fig08").set_index(["quantity", "suppression"])
    columns = {
        "probe": ("probe accuracy", "Probe accuracy falls"),
        "DAR": ("DAR@1", f"DAR@{k} rises"),
        "R": ("R@1", f"R@{k} rises"),
    }
    rows = []
    for suppressor, row in counts.iterrows():
        cells = {"Method": suppressor}
        for column, (quantity, heading) in columns.items():
            cells[f"{heading}, measured"] = f"{row[column]} / {row['pairs']}"
            if (quantity, suppressor) in expected.index:
                paper = expected.loc[(quantity, suppressor)]
                cells[f"{heading}, paper"] = f"{paper['improved']} / {paper['pairs']}"
        rows.append(cells)
    known = frame[frame["reported_as"].notna() & frame["method"].isin(reported.method_titles())]
    both = len(known.drop_duplicates(["dataset", "method"]))
    caption = f"Method–dataset pairs that improve. Of the paper's 54 pairs, {both or 'none'} were measured here."
    return table(rows, text=1, caption=caption)


def suppression_table(frame: pd.DataFrame, titles: Titles, *, k: int = 1) -> HTML:
    """Show R, DAR and probe accuracy of the original, and their changes, one line per dataset and method."""
    rows = []
    for (_, method), part in frame.groupby(["dataset", "method"], sort=False):
        by_name = part.set_index("suppression")
        original = by_name.loc["original"]
        fitted_on = f"{original['fitted_queries']} + {original['fitted_database']}"
        row = {"Dataset": original["title"], "Method": titles[method], "Fitted on": fitted_on}
        row["Queries"] = original["queries"]
        for metric, heading in (("probe", "Probe"), ("DAR", f"DAR@{k}"), ("R", f"R@{k}")):
            row[f"{heading} %"] = number(original[metric])
            row |= {f"{heading} {name}": change(by_name.loc[name, f"change_{metric}"]) for name in SUPPRESSORS}
        rows.append(row)
    caption = (
        "Original descriptors in percent, changes in percentage points. Fitted on: queries + database images of the "
        "fitting region."
    )
    if unconverged := int(frame["probe_unconverged"].sum()):
        caption += f" Of {len(frame)} probes, {unconverged} did not converge within scikit-learn's default of 1,000 iterations."
    return table(rows, text=2, caption=caption)


def heat_maps(table: pd.DataFrame, titles: Titles, *, k: int = 1) -> HTML:
    """Fig. 8: change of probe accuracy, DAR@K and R@K per suppression method, dataset and method."""
    datasets = dict(zip(table["dataset"], table["title"], strict=True))
    titles = {method: titles[method] for method in table["method"].unique()}
    # The shorter axis runs across, so that the numbers stay legible.
    across, down = (titles, datasets) if len(titles) < len(datasets) else (datasets, titles)
    names = ("method", "dataset") if across is titles else ("dataset", "method")
    drawn = []
    for column, (name, better, colours) in _QUANTITIES.items():
        size = len(SUPPRESSORS) * (1.4 + 0.6 * len(across)), 0.9 + 0.27 * len(down)
        figure, panels = drawing(size, columns=len(SUPPRESSORS))
        limit = max(10.0, float(np.nanmax(np.abs(table[column]))))
        for panel, suppressor in zip(panels, SUPPRESSORS, strict=True):
            part = table[table["suppression"] == suppressor].pivot(index=names[1], columns=names[0], values=column)
            _heat_map(panel, part.reindex(index=list(down), columns=list(across)).to_numpy(), limit, colours)
            panel.set_yticks(range(len(down)), list(down.values()))
            panel.set_xticks(range(len(across)), list(across.values()), rotation=30, ha="right")
            panel.set_title(suppressor, fontsize=9.5, pad=3, loc="left")
        figure.tight_layout()
        heading = f"{name.replace('R@K', f'R@{k}')}, change in pp: {better}"
        scale = (
            f"Colours run from red (worse) over white (0) to blue (better) at ±{limit:.0f} pp, on a square-root scale."
        )
        text = f"{heading}, by suppression of {len(titles)} methods on {len(datasets)} datasets; the table below has the numbers"
        drawn += [markup('<p class="panel-title"><b>{}.</b> {}</p>', heading, scale), embed(figure, text)]
    return join(drawn)


def _heat_map(axes: Axes, values: np.ndarray, limit: float, colours: str) -> None:
    """One panel with its numbers; the scale is linear up to ``limit`` and symmetric around zero."""
    # A root makes changes of a few points visible beside one of tens of points.
    shown = np.sign(values) * np.sqrt(np.abs(values) / limit)
    image = axes.imshow(shown, cmap=colours, vmin=-1.25, vmax=1.25, aspect="auto")
    channels = image.to_rgba(shown)[..., :3]
    linear = np.where(channels <= 0.04, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    luminance = linear @ (0.2126, 0.7152, 0.0722)
    inks = np.where(luminance > 0.18, "#101010", "#fefefe")  # contrast of at least 4.5 : 1 either way
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            axes.text(column, row, change(value), ha="center", va="center", fontsize=7.5, color=inks[row, column])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def fraction_curves(means: pd.DataFrame, *, k: int = 1, source: str = "measured in this run") -> HTML:
    """Fig. 10: mean change of DAR@K (a) and R@K (b) in percentage points against the query fitting fraction."""
    figure, panels = drawing((8.0, 3.2), columns=2)
    titles = {"change_DAR": f"(a) ΔDAR@{k} (pp)", "change_R": f"(b) ΔR@{k} (pp)"}
    for axes, (column, title) in zip(panels, titles.items(), strict=True):
        axes.axhline(0, linestyle="--", color="gray", linewidth=0.9)
        for name, rows in means.sort_values("fraction", kind="stable").groupby("suppression", sort=False):
            dots = {"color": SUPPRESSION_COLOURS[name], "marker": SUPPRESSION_MARKERS[name], "markersize": 4.5}
            axes.plot(rows["fraction"], rows[column], label=name, **dots)
            texts = (f"{name}: {change(value, digits=2)} pp" for value in rows[column])
            tell_values(axes, rows[["fraction", column]], texts)
        axes.set(title=title, xlim=(-0.01, 0.51), xticks=np.arange(0, 0.51, 0.1), xlabel="Query fitting fraction")
        axes.grid(visible=True)
    legend_below(figure, gap=1.4)
    return embed(figure, f"Mean change of DAR@{k} and R@{k} against the query fitting fraction, {source}")


def reported_fraction_curves() -> HTML:
    """Draw Fig. 10 from the values that the paper plots, on its own axes."""
    wide = reported.table("fig10").pivot_table(
        index=["suppression", "fitting_fraction"], columns="metric", values="change_pp", sort=False
    )
    names = {"fitting_fraction": "fraction", "DAR@1": "change_DAR", "R@1": "change_R"}
    return fraction_curves(wide.reset_index().rename(columns=names), source="reported by the paper")


_HELPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "change_probe": lambda changes: changes < -1e-9,
    "change_DAR": lambda changes: changes > 1e-9,
    "change_R": lambda changes: changes >= -NO_LOSS_PP - 1e-9,
}


def _helped(study: Study, column: str) -> dict[str, np.ndarray]:
    """Tell which pairs ``(pairs,)`` each suppression method helps."""
    changes = study.table.groupby("suppression", sort=False)[column]
    return {name: _HELPS[column](values.to_numpy()) for name, values in changes}


def _mostly(study: Study, column: str) -> Judged:
    """Judge whether INLP and LEACE each help more than half of the pairs."""
    helped = _helped(study, column)
    return first_of(*(_about(name, mostly(helped[name])) for name in LOW_RANK))


def _fewer_with_std(study: Study, column: str) -> Judged:
    """Judge whether STD helps fewer pairs than INLP and than LEACE."""
    helped = _helped(study, column)
    return first_of(*(_about(f"{name} against STD", more_often(helped[name], helped["STD"])) for name in LOW_RANK))


def _about(what: str, judged: Judged) -> Judged:
    return Judged(judged.verdict, f"{what}: {judged.why}")


def _counted(study: Study, column: str) -> str:
    """How many pairs each suppression method improves, in words."""
    counts = improved(study.table).set_index("suppression")
    parts = [f"{count} ({name})" for name, count in counts[column].items()]
    return f"{', '.join(parts[:-1])} and {parts[-1]} of {counts['pairs'].iloc[0]} pairs"


def _beyond_chance(study: Study, column: str) -> str:
    """How many pairs rise and fall beyond chance with each suppression method, in words."""
    parts = []
    for name in SUPPRESSORS:
        rows = (study.table["suppression"] == name).to_numpy()
        values = study.table[column].to_numpy()[rows]
        certain = holm(p_values(values, study.replicates[column][rows])) < CERTAIN
        parts.append(f"{name} {(certain & (values > 0)).sum()} up, {(certain & (values < 0)).sum()} down")
    return f"beyond chance (Holm over the pairs): {'; '.join(parts)}"


def _extreme(table: pd.DataFrame, row: int, column: str, titles: Titles) -> str:
    """A combination and its change, in words."""
    title, method, suppression, value = table.loc[row, ["title", "method", "suppression", column]]
    return f"{titles[method]} on {title}, {change(value)} pp with {suppression}"


@claimed
def labels_less_accessible(study: Study) -> Answer:
    """INLP and LEACE make conditions less accessible to a linear classifier (Fig. 8a)."""
    return f"probe accuracy falls for {_counted(study, 'probe')}", _mostly(study, "change_probe")


@claimed
def std_helps_probe_less_often(study: Study) -> Answer:
    """STD makes conditions less accessible less often (Fig. 8a)."""
    return f"probe accuracy falls for {_counted(study, 'probe')}", _fewer_with_std(study, "change_probe")


@claimed
def suppression_raises_dar(study: Study, titles: Titles, k: int = 1) -> Answer:
    """INLP and LEACE raise DAR for most pairs (Fig. 8b)."""
    most = _extreme(study.table, study.table["change_DAR"].idxmax(), "change_DAR", titles)
    found = f"DAR@{k} rises for {_counted(study, 'DAR')}; {_beyond_chance(study, 'change_DAR')}; most: {most}"
    return found, _mostly(study, "change_DAR")


@claimed
def std_raises_dar_less_often(study: Study, k: int = 1) -> Answer:
    """STD raises DAR for fewer pairs (Fig. 8b)."""
    return f"DAR@{k} rises for {_counted(study, 'DAR')}", _fewer_with_std(study, "change_DAR")


@claimed
def suppression_keeps_recall(study: Study, titles: Titles, k: int = 1) -> Answer:
    """INLP and LEACE keep R without distractors in most cases (Fig. 8c)."""
    kept = _helped(study, "change_R")
    shares = " and ".join(f"{kept[name].sum()} of {len(kept[name])} pairs ({name})" for name in LOW_RANK)
    found = f"R@{k} falls by at most {NO_LOSS_PP:g} pp for {shares}; {_beyond_chance(study, 'change_R')}"
    return found, _mostly(study, "change_R")


@claimed
def recall_falls_little(study: Study, titles: Titles, k: int = 1) -> Answer:
    """R falls by little with INLP and LEACE for every pair (Fig. 8c)."""
    chosen = study.table["suppression"].isin(LOW_RANK).to_numpy()
    rows = study.table[chosen]
    verdict, why = all_above(rows["change_R"].to_numpy(), study.replicates["change_R"][chosen], -NO_LOSS_PP)
    worst = _extreme(rows, rows["change_R"].idxmin(), "change_R", titles)
    worth = f"a query is worth up to {100 / rows['queries'].min():.2g} pp"
    return f"largest change down: {worst}", Judged(verdict, f"{why}; {worth}")


@claimed
def railway_recall_rises(study: Study, titles: Titles, k: int = 1) -> Answer:
    """R rises on Nordland in all cases (Fig. 8c)."""
    chosen = (study.table["of_nordland"] & (study.table["suppression"] != "original")).to_numpy()
    rows = study.table[chosen]
    if rows.empty:
        return "neither Nordland nor a dataset that mirrors it is here", Judged("cannot tell", "nothing was measured")
    cases = rows[["method", "suppression", "change_R"]].itertuples(index=False)
    parts = ", ".join(f"{titles[method]} {name} {change(value)}" for method, name, value in cases)
    rising = f"{(rows['change_R'] > 0).sum()} of {len(rows)} cases on {rows['title'].iloc[0]}"
    judged = all_above(rows["change_R"].to_numpy(), study.replicates["change_R"][chosen], 0)
    return f"R@{k} rises in {rising} (pp: {parts})", judged


_Change = tuple[float, np.ndarray]  # a mean over pairs, and its replicates (count,)


def _mean_changes(study: Study, column: str) -> dict[tuple[str, float], _Change]:
    """Mean change over the pairs that have every fraction, by suppression method and fraction."""
    table = study.table.reset_index(drop=True)
    table = table[has_every_fraction(table)]
    groups = table.groupby(["suppression", "fraction"], sort=False).groups
    sample = study.replicates[column]
    return {key: (table.loc[rows, column].mean(), sample[rows].mean(axis=0)) for key, rows in groups.items()}


def _at_fraction(
    study: Study, metric: str, fraction: float, k: int, judge: Callable[[dict[str, _Change]], Judged]
) -> Answer:
    """Mean changes with one fraction in words, and what ``judge`` makes of them by suppression method."""
    every = _mean_changes(study, f"change_{metric}")
    found = {name: every[name, fraction] for name in SUPPRESSORS if (name, fraction) in every}
    if not found:
        return f"the fraction {fraction:g} is not among the parameters", Judged("cannot tell", "nothing was measured")
    words = ", ".join(f"{name} {value:+.1f}" for name, (value, _) in found.items())
    return f"at {100 * fraction:g} %, mean Δ{metric}@{k} is {words} pp", judge(found)


def _all_above(changes: Iterable[_Change], bound: float) -> Judged:
    values, samples = zip(*changes, strict=True)
    return all_above(np.array(values), np.stack(samples), bound)


@claimed
def a_twentieth_raises_dar(study: Study, k: int = 1) -> Answer:
    """INLP and LEACE raise mean DAR with 5 % of the queries (Fig. 10a)."""
    return _at_fraction(study, "DAR", 0.05, k, lambda found: _all_above([found[name] for name in LOW_RANK], 0))


@claimed
def a_tenth_keeps_recall(study: Study, k: int = 1) -> Answer:
    """A tenth of the queries suffices to fit without losing mean R (Fig. 10b)."""
    return _at_fraction(study, "R", 0.1, k, lambda found: _all_above(found.values(), -CLOSE_PP))


@claimed
def std_needs_more_data(study: Study, k: int = 1) -> Answer:
    """STD does not raise mean DAR with a tenth of the queries (Fig. 10a)."""
    return _at_fraction(
        study, "DAR", 0.1, k, lambda found: _about("loss with STD", above(-found["STD"][0], -found["STD"][1], 0))
    )


@claimed
def std_stays_below(study: Study, k: int = 1) -> Answer:
    """STD stays below INLP and LEACE in mean DAR (Fig. 10a)."""
    found = _mean_changes(study, "change_DAR")
    fractions = sorted({fraction for _, fraction in found if fraction > 0})
    pairs = [(found[name, fraction], found["STD", fraction]) for fraction in fractions for name in LOW_RANK]
    if not pairs:
        return "no fraction is among the parameters", Judged("cannot tell", "nothing was measured")
    leads = [(other - std, others - stds) for (other, others), (std, stds) in pairs]
    ahead = f"{sum(lead > 0 for lead, _ in leads)} of {len(leads)} comparisons at {len(fractions)} fractions"
    return f"STD is below INLP and LEACE in {ahead}", _all_above(leads, 0)


def of_changes(study: Study, titles: Titles, k: int = 1) -> list[Finding]:
    """Return all findings on a :func:`artifact.studies.suppression.suppression_table` (Fig. 8)."""
    return [
        labels_less_accessible(study),
        std_helps_probe_less_often(study),
        suppression_raises_dar(study, titles, k),
        std_raises_dar_less_often(study, k),
        suppression_keeps_recall(study, titles, k),
        recall_falls_little(study, titles, k),
        railway_recall_rises(study, titles, k),
    ]


def of_fractions(study: Study, k: int = 1) -> list[Finding]:
    """Return all findings on :func:`artifact.studies.suppression.fitting_fraction` (Fig. 10)."""
    claims = a_twentieth_raises_dar, a_tenth_keeps_recall, std_needs_more_data, std_stays_below
    return [claim(study, k) for claim in claims]
