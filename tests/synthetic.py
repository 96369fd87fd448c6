"""Descriptors with a known cause: a place code, and a condition that pushes all descriptors along one direction."""

import sys

import numpy as np

from artifact.datasets import Dataset, Traversal
from artifact.extraction import described as stage
from artifact.extraction.described import Described
from artifact.extraction.extract import Descriptors
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry, MethodEntry

METHOD = "coded"


def _traversal(name, positions, folder=None):
    return Traversal("made", name, name, tuple(f"{i}.png" for i in range(len(positions))), positions, name * 8, folder)


def described(
    n=120, d=64, *, push=2.0, noise=0.35, extra=("dusk",), seed=0, spacing=10.0, threshold=15.0, name="made", turn=0
):
    """Two drives past the same places; day and night differ by `push` along one direction, `turn` chooses which."""
    rng = np.random.default_rng(seed)
    positions = np.column_stack([np.arange(n) * spacing, 20 * np.sin(np.arange(n) / 9)])
    steps = rng.standard_normal((n, d))
    # Neighbours look alike: the code of a place is a moving average.
    code = sum(np.roll(steps, shift, axis=0) for shift in range(3)) / np.sqrt(3)
    direction = np.linalg.qr(np.random.default_rng(99).standard_normal((d, 8)))[0][:, turn]
    shares = {"day": 1.0, "night": -1.0, "dusk": 0.9, "night_2": -1.0}
    found, traversals = {}, {}
    for traversal in ("day", "night", *extra):
        values = code + noise * rng.standard_normal((n, d)) + shares[traversal] * push * np.sqrt(d) * direction
        values = (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)
        found[traversal] = Descriptors(
            values, f"{name} {traversal}", f"{name} {traversal} {push} {seed} {n}", "images", {}
        )
        traversals[traversal] = _traversal(traversal, positions.copy())
    dataset = Dataset(name, name.capitalize(), "day→night", threshold, "metres", traversals, "day", "night", True)
    return Described(dataset, METHOD, found)


def manifest(folder, *datasets):
    """A manifest in a folder of its own that names the described datasets."""
    entries = {}
    for one in datasets:
        names = list(one.dataset.traversals)
        entries[one.dataset.name] = DatasetEntry(
            title=one.dataset.title,
            kind="folder",
            threshold={"value": one.dataset.threshold, "unit": "metres"},
            query="day",
            database="night",
            traversals={name: {"condition": name} for name in names},
            same_condition_traversal="dusk" if "dusk" in names else None,
            irrelevant_pairs=[["day", "dusk"]] if "dusk" in names else [],
        )
    method = MethodEntry(
        title="Coded",
        kind="baseline",
        backbone="–",
        aggregation="–",
        dimension=64,
        preprocessing={"resize": "fixed", "size": [8, 8]},
    )
    return Manifest(folder / "data_manifest.yaml", folder, entries, {METHOD: method}, {})


def offer(monkeypatch, *datasets):
    """Let the studies find these descriptors instead of extracting any."""
    original = stage.describe
    by_name = {one.dataset.name: one for one in datasets}

    def describe(_, dataset, method, traversals=(), *, device=None):
        assert (method, device) == (METHOD, None)
        one = by_name[dataset]
        names = dict.fromkeys(["day", "night", *traversals])
        kept = {name: one.dataset.traversals[name] for name in names}
        loaded = Dataset(
            dataset, one.dataset.title, "day→night", one.dataset.threshold, "metres", kept, "day", "night", True
        )
        return Described(loaded, method, {name: one.descriptors[name] for name in names})

    for module in [m for name, m in sys.modules.items() if name.startswith("artifact.")]:
        if getattr(module, "describe", None) is original:
            monkeypatch.setattr(module, "describe", describe)
