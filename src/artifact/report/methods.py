"""The page on the paper's methods: their weights, their equality with the authors' models, their speed."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.report.common import table


def catalogue_table(frame: pd.DataFrame) -> HTML:
    """Show size, licences and the state of the weights of the paper's methods."""
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Parameters (M)": (frame["parameters"] / 1e6).map("{:.1f}".format),
            "Dim": frame["dimension"],
            "Weights here": frame["weights"],
            "Licence of the code": frame["code_licence"],
            "Licence of the weights": frame["weights_licence"],
            "Terms": frame["terms"].replace("", "–"),
        }
    )
    return table(shown, numeric=["Parameters (M)", "Dim"])


def how_to_get(frame: pd.DataFrame) -> str:
    """Say for every method whose weights are not here how to get them, as Markdown."""
    missing = frame[frame["how"] != ""]
    if missing.empty:
        return "All weights are here."
    listed = "\n".join(f"```text\n{detail}\n```" for detail in missing["how"])
    return f"`make data PROFILE=paper` fetches what can be fetched, after showing licences and terms.\n\n{listed}"


def parity_table(frame: pd.DataFrame) -> HTML:
    """Show the recorded differences from the authors' models beside the limits of the tests."""
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Output": frame["output"],
            "Images": frame["images"].str.replace("x", "×"),
            "Values": frame["compared"].map("{:,}".format),
            "Largest difference": frame["max_abs"].map("{:.1e}".format),
            "Limit": frame["limit_abs"].map("{:g}".format),
            "Largest L2": frame["max_l2"].map("{:.1e}".format),
            "Limit of L2": frame["limit_l2"].map(lambda v: "–" if pd.isna(v) else f"{v:g}"),
        }
    )
    note = f"Recorded with PyTorch {frame['torch'].iloc[0]} on {frame['machine'].iloc[0]}, in float32."
    return table(shown, numeric=list(shown.columns[3:]), caption=note)
