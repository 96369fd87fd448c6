"""The page on the paper's methods: their weights, their equality with the authors' models, their speed."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.manifest import Manifest
from artifact.pages.common import number, table
from artifact.studies import reported
from artifact.studies.catalogue import input_in_words


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


def datasets_table(frame: pd.DataFrame) -> HTML:
    """Show Table I for the datasets of this run."""
    shown = pd.DataFrame(
        {
            "Dataset": frame["title"],
            "Query": frame["query"],
            "Database": frame["database"],
            "#Query": frame["queries"].map("{:,}".format),
            "evaluated": frame["evaluated"].map("{:,}".format),
            "#Database": frame["database_images"].map("{:,}".format),
            "Threshold": frame["threshold"],
            "Positives": frame["positives"].map("{:g}".format),
            "Condition shift": frame["shift"],
            "Images": frame["images"],
            "Mirrors": frame["mirrors"].replace("", "–"),
        }
    )
    return table(shown, numeric=["#Query", "evaluated", "#Database", "Positives"], caption="Datasets of this run.")


def reported_datasets_table() -> HTML:
    """Show the paper's Table I."""
    frame = reported.table("tab01")
    shown = pd.DataFrame(
        {
            "Dataset": frame["title"],
            "Query": frame["query"],
            "Database": frame["database"],
            "#Query": frame["queries"].map("{:,}".format),
            "#Database": frame["database_images"].map("{:,}".format),
            "Threshold": frame["threshold"],
            "Condition shift": frame["shift"],
        }
    )
    return table(shown, numeric=["#Query", "#Database"], caption="Reported by the paper.")


def methods_table(frame: pd.DataFrame) -> HTML:
    """Show Table II for the methods of this run."""
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Kind": frame["kind"].map({"baseline": "baseline", "paper": "method of the paper"}),
            "Backbone": frame["backbone"],
            "Aggregation": frame["aggregation"],
            "Dim": frame["dimension"],
            "Train data": frame["train_data"],
            "Re-rank": frame["rerank"],
            "Input": frame["input"],
            "Batch": frame["batch_size"],
            "Images per second": frame["images_per_second"].map(lambda v: number(v, digits=0)),
            "Busy %": frame["busy"].map(lambda v: number(v, digits=0)),
            "Device": frame["device"],
            "Licence": frame["licence"],
        }
    )
    return table(shown, numeric=["Dim", "Batch", "Images per second", "Busy %"], caption="Methods of this run.")


def reported_methods_table(manifest: Manifest, catalogue: pd.DataFrame) -> HTML:
    """Show the paper's Table II, and what this artifact adds to it.

    Parameters
    ----------
    manifest
        Input size, batch and licence of each method.
    catalogue
        As from :func:`artifact.studies.catalogue.methods_of_the_paper`: parameters, and whether the weights are here.
    """
    frame = reported.table("tab02")
    entries = [manifest.methods.get(name) for name in frame["method"]]
    ours = catalogue.set_index("method").reindex(frame["method"])
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Backbone": frame["backbone"],
            "Aggregation": frame["aggregation"],
            "Dim": frame["dimension"],
            "Train data": frame["train_data"],
            "Re-rank": frame["rerank"],
            "Input": [input_in_words(e.preprocessing) if e else "–" for e in entries],
            "Batch": [f"{e.batch_size}{' ‡' if e.batch_dependent else ''}" if e else "–" for e in entries],
            "Parameters (M)": ["–" if pd.isna(n) else f"{n / 1e6:.0f}" for n in ours["parameters"]],
            "Seconds an image": ["–" if pd.isna(n) else f"{n:.3g}" for n in ours["seconds"]],
            "Licence": ours["code_licence"].fillna("–").tolist(),
            "Weights here": ours["weights"].fillna("–").tolist(),
        }
    )
    how = "" if ours["seconds"].notna().any() else ": not measured yet, make bench METHODS=all does it"
    note = (
        "Reported by the paper up to re-ranking; the columns after it are this artifact's. ‡ descriptors depend on the batch. "
        f"Seconds an image: of the model on this machine, for a photograph of 480 × 640 pixels{how}."
    )
    return table(shown, numeric=["Dim", "Batch", "Parameters (M)", "Seconds an image"], caption=note)
