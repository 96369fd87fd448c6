"""Where a vehicle was at the times of its images: pose files with gaps and outliers, read strictly, interpolated linearly."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from artifact.datasets.traversal import DatasetError

_DIGITS = 16  # of a time in microseconds since 1970, from 2001 to 2286
_MICROSECONDS = 1e6


@dataclass(frozen=True)
class Poses:
    """Rows of a pose file: ``times`` ``(n,)`` int64 in microseconds, ascending, ``positions`` ``(n, 2)``, x and y in metres.

    ``found`` counts what was left out.
    """

    times: np.ndarray
    positions: np.ndarray
    found: dict[str, Any] = field(default_factory=dict)


def read(text: str, where: str, region: tuple[tuple[float, float], tuple[float, float]], fastest: float) -> Poses:
    """Read ``timestamp``, ``easting`` and ``northing`` of a CSV file, by the names in its header.

    Rows outside ``region`` (ranges of easting and northing in metres) or that a vehicle could reach from the last
    plausible row only faster than ``fastest`` (metres a second) are left out and counted.

    Raises ``DatasetError`` with the line if a column is missing, a value is no number, or times are not ascending; and if
    less than half of the rows are plausible.
    """
    first, *others = text.splitlines() or [""]
    header = [name.strip() for name in first.split(",")]
    try:
        columns = [header.index(name) for name in ("timestamp", "easting", "northing")]
    except ValueError:
        raise DatasetError(f"{where}:1: needs the columns timestamp, easting and northing; found {first!r}") from None
    times, rows = [], []
    for line, row in enumerate(csv.reader(others), start=2):
        if not row:
            continue
        here = f"{where}:{line}"
        try:
            stamp, east, north = (row[column].strip() for column in columns)
            rows.append((float(east), float(north)))
        except (ValueError, IndexError):
            raise DatasetError(f"{here}: found {','.join(row)!r}; easting and northing must be numbers") from None
        times.append(time_of(stamp, here, times))
    if len(rows) < 2:
        raise DatasetError(f"{where}: {len(rows)} rows of poses; the file is cut short, get it again")
    positions = np.array(rows)
    kept = np.array(_plausible(times, rows, region, fastest), dtype=np.int64)
    if 2 * len(kept) < len(rows):
        raise DatasetError(
            f"{where}: only {len(kept):,} of {len(rows):,} positions are plausible (in the region of the dataset and not faster "
            f"than {fastest:g} m/s); the first is {rows[0]}; is it the file of this traversal?"
        )
    found = {"pose_rows": len(rows), "implausible_pose_rows": len(rows) - len(kept)}
    return Poses(np.array(times, dtype=np.int64)[kept], positions[kept], found)


def time_of(text: str, where: str, earlier: list[int]) -> int:
    """Return a time in microseconds, later than all ``earlier`` ones, or raise ``DatasetError``."""
    if not (text.isdecimal() and len(text) == _DIGITS):
        raise DatasetError(f"{where}: found the time {text!r}; it should be in microseconds, {_DIGITS} digits")
    if earlier and int(text) <= earlier[-1]:
        what = "there twice" if int(text) == earlier[-1] else f"before the one above, {earlier[-1]}"
        raise DatasetError(f"{where}: the time {text} is {what}; get the file again, or sort it and delete doubles")
    return int(text)


def _plausible(
    times: list[int], rows: list[tuple[float, float]], region: tuple[tuple[float, float], ...], fastest: float
) -> list[int]:
    """Rows that a vehicle may have passed, each reachable from the one before."""
    (west, east), (south, north) = region
    inside = [i for i, (x, y) in enumerate(rows) if west <= x <= east and south <= y <= north]

    def reachable(a: int, b: int) -> bool:
        return math.dist(rows[a], rows[b]) <= fastest * (times[b] - times[a]) / _MICROSECONDS

    # An outlier at the beginning must not hold off the rest.
    start = next((place for place in range(len(inside) - 1) if reachable(*inside[place : place + 2])), len(inside))
    kept = inside[start : start + 1]
    for i in inside[start + 1 :]:
        if reachable(kept[-1], i):
            kept.append(i)
    return kept


def at(poses: Poses, times: np.ndarray, longest_gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate positions linearly at ``times`` ``(m,)``; nothing is extrapolated.

    Returns the indices of the times that have a position, and these ``(k, 2)``. A time before the first or after the last
    pose, or in a gap longer than ``longest_gap`` seconds, has none.

    Examples
    --------
    >>> poses = Poses(np.array([0, 1_000_000, 9_000_000]), np.array([[0.0, 0.0], [10.0, 2.0], [90.0, 2.0]]))
    >>> at(poses, np.array([-1, 500_000, 1_000_000, 5_000_000]), longest_gap=2.0)
    (array([1, 2]), array([[ 5.,  1.], [10.,  2.]]))
    """
    after = np.searchsorted(poses.times, times, side="left").clip(1, len(poses.times) - 1)
    before = after - 1
    exact = (times == poses.times[before]) | (times == poses.times[after])
    close = (poses.times[after] - poses.times[before]) <= longest_gap * _MICROSECONDS
    known = np.flatnonzero((times >= poses.times[0]) & (times <= poses.times[-1]) & (close | exact))
    a, b, t = before[known], after[known], times[known]
    share = ((t - poses.times[a]) / (poses.times[b] - poses.times[a]))[:, None]
    return known, poses.positions[a] + share * (poses.positions[b] - poses.positions[a])
