"""SVOX, test split: ``images/test/gallery`` and ``images/test/queries_…`` with positions in the names.

Only the first two fields of ``@east@north@…`` mean the same in all names. The paper thins to 1 m, but its counts are those
of all published images: nothing is thinned here.
"""

from __future__ import annotations

import math
import re

from artifact.datasets import lookalikes
from artifact.datasets.published import archives, preparation
from artifact.datasets.published.preparation import Plan, Sources
from artifact.datasets.traversal import DatasetError

_CONDITIONS = ("sun", "rain", "snow", "night", "overcast")
_FIRST_EDITION = {f"queries_{name}": f"queries_{number}" for number, name in enumerate(_CONDITIONS, start=1)}
"""Folders as they were called at first."""


def plan(sources: Sources) -> Plan:
    """Keep all images of a folder of the test split, as they are."""
    (path,) = sources.paths.values()
    sizes = {member.name: member.size for member in archives.members(path)}
    lookalikes.refuse("svox", path, sizes)
    folders = f"{sources.traversal}|{_FIRST_EDITION.get(sources.traversal, sources.traversal)}"
    pattern = re.compile(rf"(?:^|/)images?/test/(?:{folders})/([^/]+\.jpe?g)$", re.IGNORECASE)
    wanted = {name: match[1] for name in sizes if (match := pattern.search(name))}
    if not wanted:
        splits = sorted({m[1] for name in sizes if (m := re.search(r"(?:^|/)images?/([^/]+/[^/]+)/", name))})
        raise DatasetError(
            f"{path}: no images in images/test/{sources.traversal}; it holds {', '.join(splits) or 'none in images/'}"
        )
    kept = {name: (file, _position(f"{path}: {name}", file)) for name, file in wanted.items()}
    return preparation.as_published(path, sizes, kept)


def _position(where: str, file: str) -> tuple[float, float]:
    """The first two fields of a name: easting and northing in metres."""
    try:
        east, north = (float(text) for text in file.split("@")[1:3])
    except ValueError:
        east = north = math.nan
    if not (math.isfinite(east) and math.isfinite(north)):
        raise DatasetError(
            f"{where}: the name should begin with @easting@northing@ in metres; is it the published file?"
        )
    return east, north
