"""AmsterTime: a zip in a zip with ``new/NNNN.png`` and ``old/NNNN.jpg``; partners have the same number.

The numbers have gaps, so the position of a pair is its place among all numbers.
"""

from __future__ import annotations

import re

from artifact.datasets import lookalikes
from artifact.datasets.published import archives, preparation
from artifact.datasets.published.preparation import Plan, Sources
from artifact.datasets.traversal import DatasetError

_IMAGE = re.compile(r"(?:^|/)(new|old)/((\d{4})\.(?:png|jpe?g))$", re.IGNORECASE)


def plan(sources: Sources) -> Plan:
    """Keep all images of one side, as they are."""
    (path,) = sources.paths.values()
    inner = sources.scratch / "inner.zip"
    for member in archives.members(path):
        if member.name.endswith(".zip"):
            if not inner.exists():
                member.copy_to(inner)
            path = inner
            break
    sizes = {member.name: member.size for member in archives.members(path)}
    lookalikes.refuse("amstertime", path, sizes)
    images = {name: match for name in sizes if (match := _IMAGE.search(name))}
    sides = {side: sorted(m[3] for m in images.values() if m[1].lower() == side) for side in ("new", "old")}
    if sides["new"] != sides["old"] or not sides["new"]:
        odd = sorted(set(sides["new"]) ^ set(sides["old"]))
        what = f"{len(odd)} numbers are in one only, first {odd[0]}" if odd else "a number is there twice, or none is"
        raise DatasetError(
            f"{path}: new and old should hold the same numbers, but {what} ({len(sides['new'])} and {len(sides['old'])} "
            f"images); get the archive again"
        )
    index = {number: place for place, number in enumerate(sides["new"])}
    kept = {name: (m[2], (index[m[3]],)) for name, m in images.items() if m[1].lower() == sources.traversal}
    gaps = int(sides["new"][-1]) + 1 - len(index)
    return preparation.as_published(path, sizes, kept, numbers_not_used=gaps)
