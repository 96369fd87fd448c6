"""St Lucia, multiple times of day: a film and a text file with the position of each of its frames.

The latitude is written without its minus sign. Many consecutive lines are equal, since the receiver is slower than the
camera: the frame kept is the first with a new position, and nothing is interpolated, as in the paper's counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from pydantic import Field

from artifact.datasets import lookalikes
from artifact.datasets.positions import keep_spacing
from artifact.datasets.published import archives, preparation
from artifact.datasets.published.preparation import Kept, Plan, Position, Sources
from artifact.datasets.traversal import DatasetError

_ZONE, _BAND = 56, "J"
_BRISBANE = (-28.0, -27.0), (152.5, 153.5)  # latitude, longitude in degrees
_BYTES = 600_000  # of a frame as PNG, about


class Parameters(preparation.Parameters):
    """``spacing`` is in metres; ``unpaired`` the share of lines without a frame, or of frames without a line, that may be."""

    spacing: float = Field(1.0, gt=0)
    unpaired: float = Field(0.02, ge=0, lt=1)


def plan(sources: Sources) -> Plan:
    """Keep the frames of a film that have the spacing."""
    (path,) = sources.paths.values()
    video = sources.scratch / "webcam_video.avi"
    names, text = [], None
    for member in archives.members(path):
        names.append(member.name)
        if member.name.endswith("fGPS.txt"):
            folder = PurePosixPath(member.name).parent.name
            wanted = sources.traversal
            if folder != wanted and folder.replace("_", "").isdecimal():
                raise DatasetError(f"{path}: holds the traversal {folder}, not {wanted}; put it under its own name")
            text = member.read().decode("ascii", "replace")
        elif member.name.endswith(video.name) and not video.exists():
            member.copy_to(video)
    lookalikes.refuse("st_lucia", path, names)
    if text is None or not video.exists():
        lacks = "fGPS.txt" if text is None else video.name
        raise DatasetError(
            f"{path}: holds no {lacks}; it has {', '.join(names[:5]) or 'no files'}; is it the published file?"
        )
    positions = _positions(text, f"{path}: fGPS.txt")
    kept = keep_spacing(positions, sources.parameters.spacing)
    places = {int(i): tuple(map(float, positions[i])) for i in kept}
    found: dict[str, Any] = {"lines": len(positions)}
    images = _frames(video, f"{path}: {video.name}", places, len(positions), sources.parameters.unpaired, found)
    return Plan(images, len(places), _BYTES * len(places), found)


def _positions(text: str, where: str) -> np.ndarray:
    """Easting and northing in metres, UTM zone 56 south, of each line."""
    utm = preparation.optional("utm", "utm")
    rows = []
    for line, row in enumerate(text.rstrip().splitlines(), start=1):
        here = f"{where}:{line}"
        try:
            latitude, longitude = (float(value) for value in row.split(","))
        except ValueError:
            raise DatasetError(f"{here}: found {row!r}; every line should be latitude,longitude in degrees") from None
        rows.append((-abs(latitude), longitude))
        if not all(low <= value <= high for value, (low, high) in zip(rows[-1], _BRISBANE, strict=True)):
            raise DatasetError(f"{here}: {row!r} is not in Brisbane; is it the published file?")
    if not rows:
        raise DatasetError(f"{where}: it is empty; get the archive again")
    latitude, longitude = np.array(rows).T
    east, north, *_ = utm.from_latlon(latitude, longitude, force_zone_number=_ZONE, force_zone_letter=_BAND)
    return np.column_stack([east, north])


def _frames(
    video: Path, where: str, places: dict[int, Position], lines: int, unpaired: float, found: dict[str, Any]
) -> Iterator[Kept]:
    """Decode a film from its beginning, since seeking in such files is inexact, and pair its frames with the lines."""
    av = preparation.optional("av", "av")
    number = 0
    try:
        with av.open(str(video)) as container:
            stream = container.streams.video[0]
            expected = stream.frames
            for number, frame in enumerate(container.decode(stream), start=1):
                index = number - 1
                if index in places:
                    yield Kept(
                        f"frame{index:06}.png",
                        f"frame {index}",
                        places[index],
                        lambda frame=frame: preparation.as_png(frame.to_ndarray(format="rgb24")),
                    )
    except (av.FFmpegError, IndexError) as error:
        raise DatasetError(
            f"{where}: cannot be decoded after {number:,} frames ({error}); get the archive again"
        ) from None
    found |= {"frames": number, "frames_in_the_header": expected}
    if number < (1 - unpaired) * expected:
        raise DatasetError(
            f"{where}: ends after {number:,} of {expected:,} frames; it is cut short, get the archive again"
        )
    if abs(number - lines) > unpaired * lines:
        what = "lines of fGPS.txt have no frame" if lines > number else "frames have no line in fGPS.txt"
        raise DatasetError(
            f"{where}: {abs(number - lines):,} {what} ({number:,} frames, {lines:,} lines), more than unpaired={unpaired:g} "
            f"allows; get the archive again"
        )
