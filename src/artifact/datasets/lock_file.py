"""The file ``NAME.lock.json`` beside a file from elsewhere: what that was when it was first accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from artifact import store

ENDING = ".lock.json"


def path_of(path: Path) -> Path:
    """Return the lock file of a file."""
    return path.with_name(f"{path.name}{ENDING}")


def read(path: Path, keys: Sequence[str], error: type[Exception]) -> dict[str, Any]:
    """Return what the lock file of a file records, with at least these keys; raise ``error`` if it is no lock file."""
    try:
        record = store.read_json(path_of(path))
        return {**record, **{key: record[key] for key in keys}}
    except (store.StoreError, KeyError, TypeError):
        raise error(f"{path_of(path)}: not a lock file; delete it, and {path.name} is examined anew") from None


def write(path: Path, record: Mapping[str, Any]) -> None:
    """Record what a file is, and today's date."""
    store.write_json(path_of(path), {**record, "date": f"{datetime.now(UTC):%Y-%m-%d}"})
