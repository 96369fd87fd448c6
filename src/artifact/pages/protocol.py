"""The protocol page: decisions and their sensitivity."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Titles, change, shown, table, two_decimals


def protocol_table(decisions: pd.DataFrame) -> HTML:
    """Show the protocol: topic, what the paper says, what this artifact does."""
    headings = {"topic": "Topic", "paper": "The paper", "ours": "This artifact"}
    return table(decisions.rename(columns=headings).to_dict("records"), classes="findings")


def sensitivity_table(frame: pd.DataFrame, titles: Titles, *, k: int = 1) -> HTML:
    """Show the changes that open choices make, in percentage points."""

    def difference(value: float) -> str:
        return "0" if abs(value) <= 1e-9 else change(value, digits=2)

    columns = {"Dataset": "title", "Method": ("method", titles.get)}
    columns |= {f"{metric}@{k} %": (metric, two_decimals) for metric in ("R", "DAR")}
    for choice in ("ties", "excluded"):
        columns |= {f"{choice.capitalize()}: Δ{metric}": (f"{choice}_{metric}", difference) for metric in ("R", "DAR")}
    columns["Threshold ×2: ΔDAR"] = ("beyond_DAR", difference)
    return table(shown(frame, columns), text=2, caption="Changes in percentage points.")
