"""Nordland: frames of four seasons at one a second, of which a list selects 27,592 that are equal places.

The archives hold more frames than the list, in a folder or loose; the position is the place in the list.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path, PurePosixPath

from artifact.datasets import lookalikes
from artifact.datasets.published import archives, preparation
from artifact.datasets.published.preparation import Kept, Plan, Sources
from artifact.datasets.traversal import DatasetError
from artifact.manifest.layout import text_of

_FRAME = re.compile(r"images-\d{5}\.png")
_SEASONS = {"spring", "summer", "fall", "winter"}
_BYTES = 450_000  # of a frame, about


class Parameters(preparation.Parameters):
    """``list_sha256`` is the SHA-256 of the list: one bare name a line, each line ended by a line feed."""

    list_sha256: str = "6b1dcf6a8ccf2860f5b473dce84941fff87735bcb94face0af66d14fba49ff73"


def plan(sources: Sources) -> Plan:
    """Keep the frames of a season that the list names."""
    (names_file,) = sources.named(".txt")
    (path,) = sources.named(".tar.gz", ".tar", ".zip")
    index = {name: place for place, name in enumerate(_names(names_file, sources.parameters.list_sha256))}
    found: dict[str, int] = {"frames_not_in_the_list": 0}
    other_seasons = _SEASONS - {sources.traversal.lower()}

    def kept():
        seen, others = set(), []
        for member in archives.members(path):
            *folders, name = PurePosixPath(member.name).parts
            if wrong := other_seasons.intersection(map(str.lower, folders)):
                raise DatasetError(
                    f"{path}: holds frames of {', '.join(wrong)}, not of {sources.traversal}; put it under its own name"
                )
            if name in index:
                seen.add(name)
                yield Kept(name, member.name, (index[name],), member.read)
            else:
                others.append(member.name)
        if missing := sorted(index.keys() - seen):
            lookalikes.refuse("nordland", path, others)
            frames = [*seen, *(name for name in others if name.endswith(".png"))]
            lookalikes.refuse("nordland", path, frames)
            why = "it is another film or cut short"
            if len(frames) == len(index):
                why = "its frames were renumbered, so that places differ"
            raise DatasetError(
                f"{path}: {len(missing):,} of the {len(index):,} frames of the list are not in it, first {missing[0]}; {why}"
            )
        found["frames_not_in_the_list"] = sum(bool(_FRAME.search(name)) for name in others)

    return Plan(kept(), len(index), _BYTES * len(index), found)


def _names(path: Path, sha256: str) -> list[str]:
    """The names in a list that may have paths before them, ends of lines of Windows and empty lines."""
    names = [PurePosixPath(line.strip()).name for line in text_of(path).splitlines() if line.strip()]
    if hashlib.sha256("".join(f"{name}\n" for name in names).encode()).hexdigest() != sha256:
        lookalikes.refuse("nordland", path, names)
        raise DatasetError(
            f"{path}: its {len(names):,} names are not those of the list of 27,592 (images-00202.png to images-35582.png); "
            f"delete it and run again to download that list"
        )
    return names
