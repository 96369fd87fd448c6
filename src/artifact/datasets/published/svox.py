"""SVOX, test split: ``images/test/gallery`` and ``images/test/queries_…`` with positions in the names.

Only the first two fields of ``@east@north@…`` mean the same in all names. The paper thins to 1 m, but its counts are those
of all published images: nothing is thinned here.
"""

from __future__ import annotations

import math
import re

from artifact.datasets import lookalikes
from artifact.datasets.published import archives, preparation
from artifact.datasets.published.preparation import Kept, Plan, Sources
from artifact.datasets.traversal import DatasetError

_NUMBERED = {"queries_sun": 1, "queries_rain": 2, "queries_snow": 3, "queries_night": 4, "queries_overcast": 5}
"""Folders of the first edition, ``queries_1`` and on."""


class Parameters(preparation.Parameters):
    """None."""


def plan(sources: Sources) -> Plan:
    """Keep all images of a folder of the test split, as they are."""
    (path,) = sources.paths.values()
    members = {member.name: member.size for member in archives.members(path)}
    lookalikes.refuse("svox", path, members)
    folders = [sources.traversal]
    if sources.traversal in _NUMBERED:
        folders.append(f"queries_{_NUMBERED[sources.traversal]}")
    pattern = re.compile(rf"(?:^|/)images?/test/(?:{'|'.join(folders)})/([^/]+\.jpe?g)$", re.IGNORECASE)
    wanted = {name: match[1] for name in members if (match := pattern.search(name))}
    if not wanted:
        splits = sorted({m[1] for name in members if (m := re.search(r"(?:^|/)images?/([^/]+/[^/]+)/", name))})
        raise DatasetError(
            f"{path}: no images in images/test/{sources.traversal}; it holds {', '.join(splits) or 'none in images/'}"
        )
    positions = {name: _position(f"{path}: {name}", file) for name, file in wanted.items()}
    kept = (
        Kept(wanted[member.name], member.name, positions[member.name], member.read)
        for member in archives.members(path)
        if member.name in wanted
    )
    return Plan(kept, len(wanted), sum(members[name] for name in wanted), {})


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
