"""``artifact suppress``: fit a transform on descriptors in files, save it, and apply it to others."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from artifact import store
from artifact.datasets import DatasetError
from artifact.datasets.arrays import read_descriptors
from artifact.studies import fitted
from artifact.suppression.loading import load_transform
from artifact.suppression.std import STD


def fit(options: argparse.Namespace) -> Iterator[str]:
    """Fit a transform on all descriptors of two files and save it.

    Raises
    ------
    DatasetError
        If a file cannot be read or nothing can be fitted.
    """
    queries, database = (read_descriptors(path).values for path in (options.queries, options.database))
    try:
        X = np.concatenate([queries, database]).astype(np.float32)
        condition = np.repeat(["query", "database"], [len(queries), len(database)])
        fitted.fit(X, condition, [options.method], seed=options.seed)[options.method].save(options.save)
    except ValueError as error:
        raise DatasetError(str(error)) from None
    yield f"{options.save}: {options.method} fitted on {len(queries)} queries and {len(database)} database images"


def apply(options: argparse.Namespace) -> Iterator[str]:
    """Apply a saved transform to the descriptors of a file and write the result as ``.npy``, whole or not at all.

    Raises
    ------
    DatasetError
        If a file cannot be read or written, widths differ, or STD is applied without the condition.
    """
    if options.out.suffix != ".npy":
        fault = f"the ending is {options.out.suffix!r}; descriptors are written to .npy files"
        raise DatasetError(f"{options.out}: {fault}")
    found = read_descriptors(options.descriptors).values
    try:
        transform = load_transform(options.transform)
        if isinstance(transform, STD):
            if options.condition is None:
                names = ", ".join(map(str, transform.conditions_))
                raise DatasetError(f"{options.transform}: STD needs --condition; the conditions are {names}")
            changed = transform.transform(found, options.condition)
        else:
            changed = transform.transform(found)
    except ValueError as error:
        raise DatasetError(str(error)) from None
    with store.replacing(options.out) as temporary:
        np.save(temporary, changed)
    yield f"{options.out}: {changed.shape[0]} descriptors of {changed.shape[1]} values"
