"""The methods of the paper as this artifact has them: size, weights, equality with their authors' models, speed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact import methods
from artifact.datasets.positives import positives_of
from artifact.extraction import extract, timing
from artifact.manifest import Manifest
from artifact.manifest.entries import Preprocessing
from artifact.methods import parity, weights
from artifact.studies.common import PERCENT, Study

COLUMNS = [
    "method",
    "title",
    "parameters",
    "dimension",
    "seconds",
    "timed",
    "code_licence",
    "weights",
    "weights_licence",
    "terms",
    "how",
]


def methods_of_the_paper(manifest: Manifest) -> pd.DataFrame:
    """List the paper's methods with the state of their weights on this machine.

    Returns
    -------
    pandas.DataFrame
        One row per method: ``method``, ``title``, ``parameters`` (counted without allocating them), ``dimension``,
        ``seconds`` (of the model for an image, where ``make bench METHODS=all`` measured it) and ``timed`` (how),
        ``code_licence``, ``weights`` (present, missing, ...), ``weights_licence``, ``terms``, ``how`` (how to get what is
        missing).
    """
    import torch

    rows, times = [], timing.stored_times(manifest)
    for name, entry in manifest.methods.items():
        if entry.kind != "paper" or entry.builder is not None:
            continue
        with torch.device("meta"):
            model = methods.build(name)
        state = weights.state(name, entry)
        rows.append(
            {
                "method": name,
                "title": entry.title,
                "parameters": sum(tensor.numel() for tensor in model.state_dict().values()),
                "dimension": entry.dimension,
                "seconds": times.get(name, {}).get("seconds"),
                "timed": "{note}, {device}, {cores} cores".format(**times[name]) if name in times else "",
                "code_licence": entry.licence,
                "weights": state.status,
                "weights_licence": entry.weights.licence if entry.weights else "–",
                "terms": entry.weights.terms if entry.weights else "",
                "how": ""
                if state.status == "present"
                else state.detail.replace(str(manifest.data_root), "<data root>"),
            }
        )
    return pd.DataFrame(rows, columns=COLUMNS)


def parity_table(manifest: Manifest) -> pd.DataFrame:
    """Return the recorded differences from the authors' models, with printed titles.

    Returns
    -------
    pandas.DataFrame
        As from :func:`artifact.methods.parity.recorded`, with ``title``.
    """
    table = parity.recorded()
    titles = {name: entry.title for name, entry in manifest.methods.items()}
    return table.assign(title=table["method"].map(lambda name: titles.get(name, name)))


def datasets_table(manifest: Manifest, names: Iterable[str]) -> Study:
    """Table I: query and database traversals, their sizes, the threshold and the condition shift.

    Returns
    -------
    Study
        One row per dataset: ``dataset``, ``title``, ``query``, ``database``, ``queries``, ``evaluated`` (queries
        with a positive), ``database_images``, ``threshold``, ``shift``, ``positives`` (median number per
        evaluated query), ``images`` (real or rendered), ``mirrors``, ``licence``.
    """
    rows = []
    for name in names:
        entry, loaded = manifest.dataset(name), data.load(manifest, name)
        starts, _ = positives_of(loaded.query.positions, loaded.database.positions, loaded.threshold)
        counts = np.diff(starts)
        rows.append(
            {
                "dataset": name,
                "title": entry.title,
                "query": loaded.query_name,
                "database": loaded.database_name,
                "queries": len(loaded.query),
                "evaluated": int((counts > 0).sum()),
                "database_images": len(loaded.database),
                "threshold": str(entry.threshold),
                "shift": entry.shift,
                "positives": float(np.median(counts[counts > 0])) if counts.any() else 0.0,
                "images": "real" if loaded.real else "rendered",
                "mirrors": entry.mirrors or "",
                "licence": entry.licence,
            }
        )
    return Study(pd.DataFrame(rows), ())


def methods_table(manifest: Manifest, names: Iterable[str], methods: Iterable[str]) -> Study:
    """Table II: what each method is and how fast it ran on the images at hand.

    Returns
    -------
    Study
        One row per method: ``method``, ``title``, ``kind``, ``backbone``, ``aggregation``, ``dimension``,
        ``train_data``, ``rerank``, ``input`` (preprocessing in words), ``batch_size``, ``licence``, ``images_per_second``
        (the model's own rate during extraction), ``busy`` (its share of the wall time, in percent), ``device``.
    """
    rows = []
    loaded = [data.load(manifest, name) for name in names]
    for method in methods:
        entry = manifest.method(method)
        found = [
            extract.descriptors(manifest, traversal, method)
            for dataset in loaded
            for traversal in dataset.traversals.values()
        ]
        timed = [one.sidecar for one in {one.key: one for one in found}.values() if one.sidecar.get("forward_seconds")]
        forward = sum(sidecar["forward_seconds"] for sidecar in timed)
        wall = sum(sidecar["seconds"] for sidecar in timed)
        rows.append(
            {
                "method": method,
                "title": entry.title,
                "kind": entry.kind,
                "backbone": entry.backbone,
                "aggregation": entry.aggregation,
                "dimension": entry.dimension,
                "train_data": entry.train_data,
                "rerank": f"top {entry.rerank}" if entry.rerank else "–",
                "input": input_in_words(entry.preprocessing),
                "batch_size": entry.batch_size,
                "licence": entry.licence,
                "images_per_second": sum(s["shape"][0] for s in timed) / forward if timed else np.nan,
                "busy": PERCENT * forward / wall if timed else np.nan,
                "device": ", ".join(sorted({sidecar["device"] for sidecar in timed})) or "–",
            }
        )
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
