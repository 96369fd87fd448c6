"""The protocol page: decisions and their sensitivity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import number, table
from artifact.studies.protocol import Decision


def protocol_table(decisions: Sequence[Decision]) -> HTML:
    """Show the protocol: topic, what the paper says, what this artifact does."""
    rows = [{"Topic": d.topic, "The paper": d.paper, "This artifact": d.ours} for d in decisions]
    return table(pd.DataFrame(rows), classes="findings")


def sensitivity_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show the changes that open choices make, in percentage points."""

    def change(value: float) -> str:
        return "–" if pd.isna(value) else f"{value + 0.0:+.2f}" if abs(value) > 1e-9 else "0"

    shown = pd.DataFrame(
        {
            "Dataset": frame["title"],
            "Method": frame["method"].map(titles),
            f"R@{k} %": frame["R"].map(lambda v: number(v, digits=2)),
            f"DAR@{k} %": frame["DAR"].map(lambda v: number(v, digits=2)),
            "Ties: ΔR": frame["ties_R"].map(change),
            "Ties: ΔDAR": frame["ties_DAR"].map(change),
            "Excluded: ΔR": frame["excluded_R"].map(change),
            "Excluded: ΔDAR": frame["excluded_DAR"].map(change),
            "Threshold ×2: ΔDAR": frame["beyond_DAR"].map(change),
        }
    )
    return table(shown, numeric=list(shown.columns[2:]), caption="Changes in percentage points.")
