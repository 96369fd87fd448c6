"""The methods of the paper as this artifact has them: size, weights, equality with their authors' models, speed."""

from __future__ import annotations

import pandas as pd

from artifact import methods
from artifact.extraction import timing
from artifact.manifest import Manifest
from artifact.methods import parity, weights

COLUMNS = [
    "method", "title", "parameters", "dimension", "seconds", "timed", "code_licence", "weights", "weights_licence", "terms", "how",
]  # fmt: skip


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

    rows, times = [], timing.recorded(manifest)
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
