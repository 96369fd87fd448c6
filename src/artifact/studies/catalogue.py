"""The methods of the paper as this artifact has them: size, weights, equality with their authors' models, speed."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact import methods
from artifact.extraction import extract, timing
from artifact.manifest import Manifest
from artifact.manifest.entries import Preprocessing
from artifact.methods import parity, weights
from artifact.studies import reported
from artifact.studies.common import PERCENT, Study
from artifact.studies.preview import counts


def methods_of_the_paper(manifest: Manifest) -> pd.DataFrame:
    """List the paper's methods with the state of their weights on this machine.

    Columns: ``method``, ``title``, ``parameters`` (number), ``dimension``, ``seconds`` (of the model for an image,
    where ``make bench METHODS=all`` measured it) and ``timed`` (how), ``code_licence``, ``weights`` (present, missing,
    ...), ``weights_licence``, ``terms``, ``how`` (how to get what is missing).
    """
    names = [name for name, entry in manifest.methods.items() if entry.kind == "paper" and entry.builder is None]
    entries = [manifest.methods[name] for name in names]
    times, states = timing.stored_times(manifest), list(map(weights.state, names, entries))
    missing = [state.detail.replace(str(manifest.data_root), "<data root>") for state in states]
    how = "{note}, {device}, {cores} cores"
    return pd.DataFrame(
        {
            "method": names,
            "title": [entry.title for entry in entries],
            "parameters": list(map(_parameters, names)),
            "dimension": [entry.dimension for entry in entries],
            "seconds": [times.get(name, {}).get("seconds") for name in names],
            "timed": [how.format(**times[name]) if name in times else "" for name in names],
            "code_licence": [entry.licence for entry in entries],
            "weights": [state.status for state in states],
            "weights_licence": [entry.weights.licence if entry.weights else "–" for entry in entries],
            "terms": [entry.weights.terms if entry.weights else "" for entry in entries],
            "how": ["" if s.status == "present" else detail for s, detail in zip(states, missing, strict=True)],
        }
    )


def _parameters(method: str) -> int:
    """Number of a model's parameters, counted without allocating them."""
    import torch

    with torch.device("meta"):
        return sum(tensor.numel() for tensor in methods.build(method).state_dict().values())


def full_run() -> pd.DataFrame:
    """Return the recorded plan of the profile ``paper``, with printed titles: a row for each method and dataset.

    Columns as :func:`artifact.commands.plan.run_frame` writes them; a step that a method has not is missing.
    """
    with (files("artifact.studies") / "full_run.csv").open(encoding="utf-8") as stream:
        table = pd.read_csv(stream)
    return table.assign(name=table["method"].map(reported.method_titles()))


def parity_table(manifest: Manifest) -> pd.DataFrame:
    """Return :func:`artifact.methods.parity.recorded`, differences from the authors' models, with printed titles."""
    table = parity.recorded()
    titles = {name: entry.title for name, entry in manifest.methods.items()}
    return table.assign(title=table["method"].map(lambda name: titles.get(name, name)))


def datasets_table(manifest: Manifest, names: Iterable[str]) -> Study:
    """Table I: query and database traversals, their sizes, the threshold and the condition shift.

    Columns: ``dataset``, ``title``, ``query``, ``database``, ``queries``, ``evaluated`` (queries with a positive),
    ``database_images``, ``threshold``, ``shift``, ``positives`` (median number per evaluated query), ``images`` (real,
    rendered or made descriptors), ``mirrors``, ``licence``.
    """
    rows = []
    for name in names:
        entry, loaded = manifest.dataset(name), data.load(manifest, name)
        found = counts(loaded.query.positions, loaded.database.positions, loaded.threshold)
        rows.append(
            {
                "dataset": name,
                "title": entry.title,
                "query": loaded.query_name,
                "database": loaded.database_name,
                "queries": found["queries"],
                "evaluated": found["evaluated"],
                "database_images": found["database"],
                "threshold": str(entry.threshold),
                "shift": entry.shift,
                "positives": found["median"],
                "images": "real" if loaded.real else "rendered" if entry.kind == "city" else "made descriptors",
                "mirrors": entry.mirrors or "",
                "licence": entry.licence,
            }
        )
    return Study(pd.DataFrame(rows), ())


def beside_the_paper(manifest: Manifest, measured: pd.DataFrame) -> pd.DataFrame:
    """Return the paper's Table I with the counts of a run, a :func:`datasets_table`, in columns of their own.

    Columns beside the paper's: ``here`` (images real, made descriptors, or not in this run), ``queries_here``,
    ``evaluated_here``, ``database_images_here`` (text, with a mark where they differ from the paper's), ``licence``,
    ``citation`` and ``source``, an address.
    """
    entries = {entry.reported_as: (name, entry) for name, entry in manifest.datasets.items() if entry.reported_as}
    ours = measured.set_index("dataset")
    rows = []
    for row in reported.table("tab01").to_dict("records"):
        name, entry = entries.get(row["dataset"], (None, None))
        found = ours.loc[name] if name in ours.index else None
        row["evaluated"] = reported.EVALUATED_QUERIES[row["dataset"]]
        row["here"] = "not in this run" if found is None else found["images"]
        for key in ("queries", "evaluated", "database_images"):
            row[f"{key}_here"] = "–" if found is None else f"{found[key]:,}{'' if found[key] == row[key] else ' ≠'}"
        row |= {"licence": entry.licence, "citation": entry.citation} if entry else {"licence": "–", "citation": "–"}
        rows.append(row | {"source": entry.sources[0].url if entry and entry.sources else ""})
    return pd.DataFrame(rows)


def methods_table(manifest: Manifest, names: Iterable[str], methods: Iterable[str]) -> Study:
    """Table II: what each method is and how fast it ran on the images at hand.

    Columns: ``method``, ``title``, ``kind``, ``backbone``, ``aggregation``, ``dimension``, ``train_data``, ``rerank``,
    ``input`` (preprocessing in words), ``batch_size``, ``licence``, ``images_per_second`` (the model's own rate during
    extraction), ``busy`` (its share of the wall time, in percent), ``device``.
    """
    rows = []
    traversals = [traversal for name in names for traversal in data.load(manifest, name).traversals.values()]
    for method in methods:
        entry = manifest.method(method)
        found = {one.key: one for one in (extract.descriptors(manifest, each, method) for each in traversals)}
        timed = [one.sidecar for one in found.values() if one.sidecar.get("forward_seconds")]
        forward = sum(sidecar["forward_seconds"] for sidecar in timed)
        wall = sum(sidecar["seconds"] for sidecar in timed)
        row = {"method": method, "title": entry.title, "kind": entry.kind, "backbone": entry.backbone}
        row |= {"aggregation": entry.aggregation, "dimension": entry.dimension, "train_data": entry.train_data}
        row["rerank"] = f"top {entry.rerank}" if entry.rerank else "–"
        row |= {"input": input_in_words(entry.preprocessing), "batch_size": entry.batch_size, "licence": entry.licence}
        row["images_per_second"] = sum(sidecar["shape"][0] for sidecar in timed) / forward if timed else np.nan
        row["busy"] = PERCENT * forward / wall if timed else np.nan
        rows.append(row | {"device": ", ".join(sorted({sidecar["device"] for sidecar in timed})) or "–"})
    return Study(pd.DataFrame(rows), ())


def input_in_words(preprocessing: Preprocessing) -> str:
    """Say how images are prepared, for example ``322×322 bicubic``."""
    p = preprocessing
    size = f"{p.size[0]}×{p.size[1]}" if p.size else "native size"
    if p.longest_side:
        size += f", at most {p.longest_side}"
    crop = f", cropped to ×{p.crop_to_multiple_of}" if p.crop_to_multiple_of > 1 else ""
    how = f" {p.interpolation}" if p.size or p.longest_side else ""
    return f"{size}{how}{crop}{', grey' if p.colour == 'grey' else ''}{'' if p.antialias else ', not antialiased'}"
