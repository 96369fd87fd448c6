"""Write the descriptors that ship with the package, so that a machine without the images still shows real results.

For maintainers: run where the images are, then commit ``src/artifact/datasets/shipped_descriptors``. The values are stored as float16; the
tests assert that every rank stays the same.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from artifact import datasets, store
from artifact.datasets import shipped
from artifact.datasets.appearance import appearance, appearance_key
from artifact.extraction import extract
from artifact.manifest import Manifest


def ship(manifest: Manifest, dataset: str, methods: Iterable[str]) -> list[str]:
    """Store a dataset's descriptors and image statistics in the package.

    Parameters
    ----------
    manifest, dataset
        The dataset; its images must be at hand.
    methods
        Names of the methods.

    Returns
    -------
    list of str
        The files written.

    Raises
    ------
    DatasetError
        If the images are not on this machine.
    """
    entry = manifest.dataset(dataset)
    folder = shipped.folder() / (entry.root or dataset)
    traversals = [datasets.load_traversal(manifest, dataset, name) for name in entry.traversals]
    for traversal in traversals:
        traversal.image_paths()
    record = {t.name: {"image_names": list(t.image_names), "digest": t.digest} for t in traversals}
    store.write_json(folder / "traversals.json", record)
    written = []
    for traversal in traversals:
        path = folder / f"{traversal.name}-appearance.npy"
        with store.replacing(path) as temporary:
            np.save(temporary, appearance(traversal, manifest.cache))
        kept = {"key": appearance_key(traversal), "traversal": traversal.name, "sha256": store.digest_of_file(path)}
        store.write_json(path.with_suffix(".json"), kept)
        written.append(str(path))
    for method in methods:
        for traversal in traversals:
            found = extract.descriptors(manifest, traversal, method, progress=True)
            path = folder / f"{traversal.name}-{method}.npy"
            with store.replacing(path) as temporary:
                np.save(temporary, found.values.astype(np.float16))
            kept = {name: found.sidecar[name] for name in ("key", "method", "traversal", "images", "shape", "torch")}
            digest = store.digest_of_file(path)
            store.write_json(path.with_suffix(".json"), {**kept, "dtype": "float16", "sha256": digest})
            written.append(str(path))
    return written
