"""Write the descriptors that ship with the package, so that a machine without the images still shows real results.

For maintainers: run where the images are, then commit ``src/artifact/datasets/shipped_descriptors``. The values are stored as float16; the
tests assert that every rank stays the same. The vocabulary of VLAD is made here too, from the images of a rendered dataset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sklearn.cluster import KMeans

from artifact import datasets, methods, store
from artifact.datasets import shipped
from artifact.datasets.appearance import appearance, appearance_key
from artifact.extraction import extract, jobs, reading
from artifact.manifest import Manifest
from artifact.methods import efficientnet_lite

_TRUNK = "efficientnet_lite0"
_WORDS = 16


def ship(manifest: Manifest, dataset: str, methods: Iterable[str]) -> list[str]:
    """Store a dataset's descriptors and image statistics in the package; of a rendered one, a vocabulary from its images.

    Returns the files written.

    Raises
    ------
    DatasetError
        If the images are not on this machine.
    """
    entry = manifest.dataset(dataset)
    if entry.kind == "city":
        return [_ship_vocabulary(manifest, dataset)]
    folder = shipped.folder() / (entry.root or dataset)
    traversals = [datasets.load_traversal(manifest, dataset, name) for name in entry.traversals]
    for traversal in traversals:
        traversal.image_paths()
    record = {t.name: {"image_names": list(t.image_names), "digest": t.digest} for t in traversals}
    store.write_json(folder / "traversals.json", record)
    written = []
    for traversal in traversals:
        kept = {"key": appearance_key(traversal), "traversal": traversal.name}
        path = folder / f"{traversal.name}-appearance.npy"
        written.append(_save(path, appearance(traversal, manifest.cache), kept))
    for method in methods:
        for traversal in traversals:
            found = extract.descriptors(manifest, traversal, method, progress=True)
            kept = {name: found.sidecar[name] for name in ("key", "method", "traversal", "images", "shape", "torch")}
            path = folder / f"{traversal.name}-{method}.npy"
            written.append(_save(path, found.values.astype(np.float16), {**kept, "dtype": "float16"}))
    return written


def _save(path: Path, values: np.ndarray, record: Mapping[str, Any]) -> str:
    with store.replacing(path) as temporary:
        np.save(temporary, values)
    store.seal(path, record)
    return str(path)


def _ship_vocabulary(manifest: Manifest, dataset: str) -> str:
    """Store the vocabulary of EfficientNet's VLAD in the package: k-means of local features of a dataset's images.

    Every fourth feature of every image of query and database is used; the sidecar says which images. Returns the file
    written. The revision of the method must be raised if the vocabulary changes.
    """
    entry, loaded = manifest.method(_TRUNK), datasets.load(manifest, dataset)
    model, images = methods.model_of(_TRUNK, entry), [*loaded.query.image_paths(), *loaded.database.image_paths()]
    features = []
    for prepared, _ in reading.read_batches(jobs.batches(images, entry.batch_size), entry.preprocessing):
        with torch.inference_mode():
            maps = model.maps(torch.from_numpy(np.stack(prepared)))
            features.append(efficientnet_lite.local_features(maps)[:, ::4].flatten(0, 1).numpy())
    found = KMeans(_WORDS, n_init=3, random_state=0).fit(np.concatenate(features))
    path = Path(methods.__file__).parent / efficientnet_lite.VOCABULARY
    made = {"dataset": dataset, "images": [loaded.query.digest, loaded.database.digest], "seed": 0}
    return _save(path, found.cluster_centers_.astype(np.float32), made)
