"""Other data under the name of one of the paper's datasets, told apart by names, counts and sizes.

Each would give plausible numbers that mean something else.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from artifact.datasets.traversal import DatasetError

_REWRITTEN = r"(^|/)@[^/]*@[^/]*@[^/]*\.jpe?g$"
_DOWNLOADER = "the version of VPR-datasets-downloader, renamed and saved again as JPEG"

_NAMES = {
    "amstertime": {
        _REWRITTEN: f"{_DOWNLOADER}, in which the old photographs are the queries; the paper's queries are the new ones"
    },
    "gardens_point": {_REWRITTEN: _DOWNLOADER},
    "nordland": {
        _REWRITTEN: f"{_DOWNLOADER}, in which winter is the query; the paper's query is summer",
        r"\.parquet$": "the partition of Olid et al. with 28,865 images a season; the paper's has 27,592",
    },
    "robotcar": {
        r"(^|/)(stereo/)?(left|right)/\d{16}\.png$": "images of stereo/left or stereo/right; the paper uses stereo/centre",
        r"(^|/)mono_(left|right|rear)/": "images of the mono cameras; the paper uses stereo/centre",
        r"(^|/)\d{19}\.png$": "images of the radar dataset of 2019, with times in nanoseconds; the paper uses the one of 2014",
        r"-reference/|(^|/)(night-rain|overcast-winter|dusk|dawn)/(rear|left|right)/": "RobotCar Seasons; the paper uses the traversals",
        _REWRITTEN: _DOWNLOADER,
    },
    "st_lucia": {
        _REWRITTEN: f"{_DOWNLOADER}, thinned to 5 m; the paper thins to 1 m",
        r"(^|/)GT\.npz$": "StLucia_small, frames without GPS; the paper's positions are those of fGPS.txt",
    },
    "svox": {},
}
"""What files belong to if a name matches, by recipe and pattern."""

_COUNTS = {
    ("gardens_point", 100): "the version with every second of the 200 images",
    ("nordland", 2760): "every tenth image (“Nordland*”); the paper's has 27,592",
    ("nordland", 3450): "the test split of 3,450 images; the paper's has 27,592",
    ("nordland", 28865): "the partition of Olid et al. with 28,865 images; the paper's has 27,592",
    ("nordland", 35768): "all frames of the film; the paper's are the 27,592 of a list",
}


def refuse(recipe: str, where: Path | str, names: Collection[str]) -> None:
    """Raise ``DatasetError`` that says what it is if names of files are known to be those of other data.

    ``recipe`` is the one of the paper's datasets that they should be, ``names`` are relative, with folders.
    """
    for pattern, what in _NAMES[recipe].items():
        for name in names:
            if re.search(pattern, name):
                raise DatasetError(f"{where}: {name!r} belongs to {what}")
    if what := _COUNTS.get((recipe, len(names))):
        raise DatasetError(f"{where}: {len(names):,} images are {what}")
