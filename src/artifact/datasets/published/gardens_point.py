"""Gardens Point Walking: three folders of ``Image000.jpg`` to ``Image199.jpg``; equal numbers are equal places."""

from __future__ import annotations

import re

from artifact.datasets import lookalikes
from artifact.datasets.published import archives, preparation
from artifact.datasets.published.preparation import Plan, Sources
from artifact.datasets.traversal import DatasetError


def plan(sources: Sources) -> Plan:
    """Keep all images of a folder; the position is the number in the name."""
    (path,) = sources.paths.values()
    pattern = re.compile(rf"(?:^|/){sources.traversal}/(Image(\d{{3}})\.jpg)$")
    sizes = {member.name: member.size for member in archives.members(path)}
    lookalikes.refuse("gardens_point", path, sizes)
    found = {name: match for name in sizes if (match := pattern.search(name))}
    numbers = sorted(int(match[2]) for match in found.values())
    lookalikes.refuse("gardens_point", f"{path}, {sources.traversal}", [str(number) for number in numbers])
    if numbers != list(range(len(numbers))) or not numbers:
        missing = sorted(set(range(max(numbers, default=0) + 1)) - set(numbers))
        raise DatasetError(
            f"{path}: {sources.traversal}/Image000.jpg and on should be numbered without gaps; {len(numbers)} are there, "
            f"missing: {missing[:5]}; get the archive again"
        )
    return preparation.as_published(path, sizes, {name: (match[1], (int(match[2]),)) for name, match in found.items()})
