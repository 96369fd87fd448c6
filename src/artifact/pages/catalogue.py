"""Tables I and II, and the page on the paper's methods: their weights, their equality with the authors' models."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.manifest import Manifest
from artifact.pages.common import or_dash, shown, table, whole
from artifact.studies import reported
from artifact.studies.catalogue import input_in_words

_KINDS = {"baseline": "baseline", "paper": "method of the paper"}
_DATASETS = {
    "Dataset": "title",
    "Query": "query",
    "Database": "database",
    "#Query": ("queries", "{:,}".format),
    "evaluated": ("evaluated", "{:,}".format),
    "#Database": ("database_images", "{:,}".format),
    "Threshold": "threshold",
    "Positives": ("positives", "{:g}".format),
    "Condition shift": "shift",
    "Images": "images",
    "Mirrors": ("mirrors", or_dash),
}
_METHODS = {
    "Method": "title",
    "Kind": ("kind", _KINDS.__getitem__),
    "Backbone": "backbone",
    "Aggregation": "aggregation",
    "Dim": "dimension",
    "Train data": "train_data",
    "Re-rank": "rerank",
    "Input": "input",
    "Batch": "batch_size",
    "Images per second": ("images_per_second", whole),
    "Busy %": ("busy", whole),
    "Device": "device",
    "Licence": "licence",
}
_WEIGHTS = {
    "Method": "title",
    "Parameters (M)": ("parameters", lambda n: f"{n / 1e6:.1f}"),
    "Dim": "dimension",
    "Weights here": "weights",
    "Licence of the code": "code_licence",
    "Licence of the weights": "weights_licence",
    "Terms": ("terms", or_dash),
}
_PARITY = {
    "Method": "title",
    "Output": "output",
    "Images": ("images", lambda size: size.replace("x", "×")),
    "Values": ("compared", "{:,}".format),
    "Largest difference": ("max_abs", "{:.1e}".format),
    "Limit": ("limit_abs", "{:g}".format),
    "Largest L2": ("max_l2", "{:.1e}".format),
    "Limit of L2": ("limit_l2", lambda v: "–" if pd.isna(v) else f"{v:g}"),
}


def catalogue_table(frame: pd.DataFrame) -> HTML:
    """Show size, licences and the state of the weights of the paper's methods."""
    return table(shown(frame, _WEIGHTS), numeric=["Parameters (M)", "Dim"])


def how_to_get(frame: pd.DataFrame) -> str:
    """Say for every method whose weights are not here how to get them, as Markdown."""
    missing = frame[frame["how"] != ""]
    if missing.empty:
        return "All weights are here."
    listed = "\n".join(f"```text\n{detail}\n```" for detail in missing["how"])
    return f"`make data PROFILE=paper` fetches what can be fetched, after showing licences and terms.\n\n{listed}"


def parity_table(frame: pd.DataFrame) -> HTML:
    """Show the recorded differences from the authors' models beside the limits of the tests."""
    note = f"Recorded with PyTorch {frame['torch'].iloc[0]} on {frame['machine'].iloc[0]}, in float32."
    return table(shown(frame, _PARITY), text=3, caption=note)


def datasets_table(frame: pd.DataFrame, caption: str = "Datasets of this run.") -> HTML:
    """Show Table I for the datasets of this run."""
    return table(shown(frame, _DATASETS), numeric=["#Query", "evaluated", "#Database", "Positives"], caption=caption)


def reported_datasets_table() -> HTML:
    """Show the paper's Table I."""
    return datasets_table(reported.table("tab01"), "Reported by the paper.")


def methods_table(frame: pd.DataFrame) -> HTML:
    """Show Table II for the methods of this run."""
    numeric = ["Dim", "Batch", "Images per second", "Busy %"]
    return table(shown(frame, _METHODS), numeric=numeric, caption="Methods of this run.")


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
    added = pd.DataFrame(
        {
            "Input": [input_in_words(e.preprocessing) if e else "–" for e in entries],
            "Batch": [f"{e.batch_size}{' ‡' if e.batch_dependent else ''}" if e else "–" for e in entries],
            "Parameters (M)": [whole(n / 1e6) for n in ours["parameters"]],
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
    both = pd.concat([shown(frame, _METHODS), added], axis=1)
    return table(both, numeric=["Dim", "Batch", "Parameters (M)", "Seconds an image"], caption=note)
