"""Tables I and II, and the page on the paper's methods: their weights, their equality with the authors' models."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact import datasets as data
from artifact.datasets.published.preparation import in_words
from artifact.manifest import Manifest
from artifact.pages.common import Columns, join, label, markup, or_dash, paragraph, shown, table, whole
from artifact.pages.galleries import example_strips
from artifact.pages.preview import positions_figure
from artifact.studies import reported
from artifact.studies.catalogue import input_in_words

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
_BESIDE = {
    "Dataset": "title",
    "Query": "query",
    "Database": "database",
    "#Query": ("queries", "{:,}".format),
    "#Query here": "queries_here",
    "Evaluated": ("evaluated", "{:,}".format),
    "Evaluated here": "evaluated_here",
    "#Database": ("database_images", "{:,}".format),
    "#Database here": "database_images_here",
    "Threshold": "threshold",
    "Condition shift": "shift",
}
_METHODS = {
    "Method": "title",
    "Kind": ("kind", {"baseline": "baseline", "paper": "method of the paper"}.__getitem__),
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


def full_run_table(frame: pd.DataFrame) -> HTML:
    """Show what the whole paper takes: hours of each step, and a sum for each method."""

    def hours(value: float) -> str:
        return "–" if pd.isna(value) else f"{value:,.2f}" if value < 10 else f"{value:,.0f}"

    steps = [column for column in frame if column.endswith("_h")]
    by_method = frame.groupby("name", sort=False)
    sums = by_method[[*steps, "images", "disk"]].sum(min_count=1).assign(memory=by_method["memory"].max()).reset_index()
    sums["total"] = sums[steps].sum(axis=1)
    columns: Columns = {"Method": "name", "Images": ("images", "{:,.0f}".format)}
    columns |= {f"{step.removesuffix('_h')} h": (step, hours) for step in steps} | {"Total h": ("total", hours)}
    columns |= {f"{what.title()} GB": (what, lambda n: f"{n / 1e9:.1f}") for what in ("memory", "disk")}
    note = f"{sums['total'].sum():,.0f} hours in all, on one machine: {frame['machine'].iloc[0]}."
    return table(shown(sums, columns), text=1, caption=f"{note} Predicted from short measured probes.")


def how_to_get(frame: pd.DataFrame) -> HTML:
    """Say for every method whose weights are not here how to get them."""
    missing = frame[frame["how"] != ""]
    if missing.empty:
        return paragraph("All weights are here.")
    return markup(
        "<p><code>make data PROFILE=paper</code> fetches what can be fetched, after showing licences and terms.</p>{}",
        join(markup("<pre>{}</pre>", detail) for detail in missing["how"]),
    )


def parity_table(frame: pd.DataFrame) -> HTML:
    """Show the recorded differences from the authors' models beside the limits of the tests."""
    note = f"Recorded with PyTorch {frame['torch'].iloc[0]} on {frame['machine'].iloc[0]}, in float32."
    return table(shown(frame, _PARITY), text=3, caption=note)


def datasets_table(frame: pd.DataFrame) -> HTML:
    """Show Table I for the datasets of this run."""
    numeric = ["#Query", "evaluated", "#Database", "Positives"]
    return table(shown(frame, _DATASETS), numeric=numeric, caption="Datasets of this run.")


def beside_the_paper(frame: pd.DataFrame) -> HTML:
    """Show the paper's Table I with the counts of this run beside its own."""
    numeric = [heading for heading in _BESIDE if heading.startswith("#") or "valuated" in heading]
    caption = "The paper's Table I; columns with “here” are counts of this run, ≠ where they differ from the paper's."
    return table(shown(frame, _BESIDE), numeric=numeric, caption=caption)


def terms_table(frame: pd.DataFrame) -> HTML:
    """Show under what licence the images of each dataset of the paper come, what to cite, and from where."""
    return table(shown(frame, {"Dataset": "title", "Licence": "licence", "Cite": "citation", "Source": "source"}))


def glance(manifest: Manifest, name: str) -> HTML:
    """Show where the images of a dataset are, examples of a query, its place and a distractor, and how it was prepared."""
    dataset = data.load(manifest, name)
    parts = [markup("<h3>{}</h3>", f"{dataset.title}, {dataset.shift}")]
    parts += [label(f"{difference}.") for difference in dataset.differences]
    parts += [positions_figure(dataset), example_strips(dataset)]
    for traversal, one in dataset.traversals.items():
        if record := one.preparation:
            how = in_words(record["parameters"] | record["found"])
            parts.append(paragraph(f"{traversal}: prepared {record['date']}{how}"))
    return join(parts)


def methods_table(frame: pd.DataFrame) -> HTML:
    """Show Table II for the methods of this run."""
    numeric = ["Dim", "Batch", "Images per second", "Busy %"]
    return table(shown(frame, _METHODS), numeric=numeric, caption="Methods of this run.")


def reported_methods_table(manifest: Manifest, catalogue: pd.DataFrame) -> HTML:
    """Show the paper's Table II, and what manifest and :func:`artifact.studies.catalogue.methods_of_the_paper` add."""
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
