"""The page on what ranking costs."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import number, shown, table, two_decimals, whole
from artifact.pages.style import drawing, embed
from artifact.studies.how_fast import NO_DISTRACTORS, symmetry_limit


def costs_figure(times: pd.DataFrame) -> HTML:
    """Draw what each work costs as a share of the bare product, with the limit that symmetry sets."""
    first = times.iloc[0]
    limit = symmetry_limit(first["queries"], first["database"])
    figure, axes = drawing((4.4, 0.56 * len(times) + 0.9))  # narrow: on a phone its letters stay readable
    colours = ["#999999" if pd.isna(pairs) else "#0072b2" for pairs in times["pairs"]]
    shares = times["share"].map(two_decimals)
    axes.bar_label(axes.barh(times.index, times["share"], height=0.45, color=colours), shares, padding=3)
    for place, work in times["work"].items():
        axes.text(0, place - 0.28, f" {work}", va="bottom")
    marked = times.index[times["work"] != NO_DISTRACTORS]
    axes.vlines([limit] * len(marked), marked - 0.25, marked + 0.25, color="black", linewidth=1.0, linestyle=":")
    axes.set(xlabel="time, as a share of the bare product", yticks=[], ylim=(len(times) - 0.5, -0.8))
    axes.set_title(f"dotted: pairs left by symmetry, {limit:.2f}", fontsize="medium")
    axes.margins(x=0.12)
    told = "; ".join(f"{work}: {share}" for work, share in zip(times["work"], shares, strict=True))
    return embed(figure, f"Bars: time as a share of the bare matrix product. {told}.")


def costs_table(times: pd.DataFrame) -> HTML:
    """Show the seconds, and how many pairs were looked at again."""
    columns = {
        "Work": "work",
        "Seconds": ("seconds", two_decimals),
        "Of the bare product": ("share", two_decimals),
        "Pairs, all views": ("pairs", whole),
        "In float64": ("second", whole),
        "In whole numbers": ("third", whole),
    }
    return table(shown(times, columns), text=1)


def growth_figure(sizes: pd.DataFrame) -> HTML:
    """Draw the time of :func:`artifact.studies.how_fast.growth` against the number of pairs."""
    figure, axes = drawing((3.8, 2.6))
    millions = sizes["pairs"] / 1e6
    axes.plot(millions, sizes["seconds"], marker="o", color="#0072b2")
    axes.set(xlabel="millions of pairs", ylabel="seconds", xlim=(0, None), ylim=(0, None))
    points = zip(millions, sizes["seconds"], strict=True)
    drawn = "; ".join(f"{number(x, digits=1)} million pairs: {two_decimals(y)} s" for x, y in points)
    return embed(figure, f"Seconds against the number of pairs. {drawn}.")


def costs_sentence(times: pd.DataFrame) -> str:
    """Say on what the times were taken."""
    first, used = times.iloc[0], times["product"].dropna()
    return (
        f"Made descriptors: {whole(first['queries'])} queries, {whole(first['database'])} database images of "
        f"{whole(first['dimension'])} values; the distractors are the queries. Processor: {first['processor']}. First look "
        f"by: {', '.join(dict.fromkeys(used))}."
    )
