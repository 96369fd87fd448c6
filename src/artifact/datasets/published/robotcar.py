"""Oxford RobotCar, ``stereo/centre``: raw mosaics in chunks, positions from RTK or INS at the times of the images.

Images are demosaiced (bilinear), and undistorted if asked; frames without a position are left out and counted; a frame is
kept when it is at least the spacing from the last one kept, as the paper does.
"""

from __future__ import annotations

import io
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image
from pydantic import Field

from artifact.datasets import lookalikes
from artifact.datasets.positions import keep_spacing
from artifact.datasets.published import archives, poses, preparation
from artifact.datasets.published.preparation import Kept, Plan, Position, Sources
from artifact.datasets.traversal import DatasetError

_OXFORD = (610_000.0, 630_000.0), (5_725_000.0, 5_745_000.0)
"""Ranges of easting and northing in UTM zone 30U, in metres."""

_FRAME = re.compile(r"(?:^|/)([\d-]+)/stereo/centre/(\d+)\.png$")
_MODEL = "stereo_narrow_left_distortion_lut.bin"  # the model of stereo/centre
_ABSENT = 0.01  # share of a chunk's frames that may be absent from its archive
_COVERED = 0.5  # share of the frames that must have a position
_BYTES = 1.6  # of a colour image as PNG, per pixel


class Parameters(preparation.Parameters):
    """Parameters of the preparation.

    ``poses`` is ``rtk``, ``ins``, or ``rtk_or_ins`` (INS where the ground truth lacks the traversal). ``spacing`` is in
    metres, ``longest_gap`` between two poses in seconds, ``fastest`` in metres a second; ``size`` is width and height of
    the raw images in pixels.
    """

    poses: Literal["rtk_or_ins", "rtk", "ins"] = "rtk_or_ins"
    undistort: bool = False
    spacing: float = Field(1.0, gt=0)
    longest_gap: float = Field(2.0, gt=0)
    fastest: float = Field(50.0, gt=0)
    size: tuple[int, int] = (1280, 960)


def plan(sources: Sources) -> Plan:
    """Keep the frames of a traversal that have a position and the spacing."""
    chunks = [path for path in sources.named(".tar") if "_stereo_centre_" in path.name]
    frames, found = _frames(chunks, sources.traversal)
    times = np.array(sorted(frames), dtype=np.int64)
    track, kind = _poses(sources)
    known, positions = poses.at(track, times, sources.parameters.longest_gap)
    if len(known) < _COVERED * len(times):
        raise DatasetError(
            f"{sources.traversal}: only {len(known):,} of {len(times):,} frames have a position: the poses ({kind}) cover "
            f"{track.times[0]} to {track.times[-1]}, the frames {times[0]} to {times[-1]}; are both of this traversal?"
        )
    kept = keep_spacing(positions, sources.parameters.spacing)
    places = {int(times[known[i]]): tuple(map(float, positions[i])) for i in kept}
    found |= {"frames": len(times), "poses": kind, **track.found, "frames_without_pose": len(times) - len(known)}
    size = int(_BYTES * np.prod(sources.parameters.size)) * len(places)
    return Plan(_images(sources, chunks, places), len(places), size, found)


def _frames(chunks: list[Path], traversal: str) -> tuple[dict[int, Path], dict[str, Any]]:
    """Archive of each frame by its time, and how many that the traversal should have are in none."""
    frames: dict[int, Path] = {}
    others: list[str] = []
    stamps = ""
    for path in chunks:
        before = len(frames)
        for member in archives.members(path):
            if match := _FRAME.search(member.name):
                if match[1] != traversal:
                    raise DatasetError(
                        f"{path}: {member.name!r} is of the traversal {match[1]}; put it under its own name"
                    )
                time = poses.time_of(match[2], f"{path}: {member.name}", [])
                if time in frames:
                    raise DatasetError(f"{path}: the frame {time} is in {frames[time].name} too; get both again")
                frames[time] = path
            elif member.name.endswith("stereo.timestamps"):
                stamps = member.read().decode("ascii", "replace")
            else:
                others.append(member.name)
        if len(frames) == before:
            lookalikes.refuse("robotcar", path, others)
            raise DatasetError(f"{path}: holds no stereo/centre images; is it the published file?")
    return frames, _absent(stamps, frames, traversal)


def _absent(stamps: str, frames: dict[int, Path], traversal: str) -> dict[str, Any]:
    """Compare the frames with ``stereo.timestamps``, whose lines have the time of a frame and its chunk."""
    if not stamps:
        return {"frames_absent": "not known, there is no stereo.timestamps"}
    where = f"{traversal}/stereo.timestamps"
    chunks: dict[str, list[bool]] = defaultdict(list)
    earlier: list[int] = []
    for line, row in enumerate(filter(None, stamps.splitlines()), start=1):
        stamp, _, chunk = row.partition(" ")
        earlier.append(poses.time_of(stamp, f"{where}:{line}", earlier))
        chunks[chunk.strip()].append(earlier[-1] in frames)
    for chunk, there in chunks.items():
        if there.count(False) > _ABSENT * len(there):
            file = f"{traversal}_stereo_centre_{int(chunk):02}.tar" if chunk.isdecimal() else f"chunk {chunk!r}"
            raise DatasetError(
                f"{file}: {there.count(False):,} of its {len(there):,} frames are absent; it was cut short, get it again"
            )
    return {"frames_absent": sum(there.count(False) for there in chunks.values())}


def _poses(sources: Sources) -> tuple[poses.Poses, str]:
    """The poses of the traversal, and which they are."""
    p, wanted = sources.parameters, sources.traversal
    candidates = {
        "rtk": ("rtk.zip", rf"(?:^|/){wanted}/rtk\.csv$"),
        "ins": (f"{wanted}_gps.tar", rf"(?:^|/){wanted}/gps/ins\.csv$"),
    }
    asked = p.poses.split("_or_")
    for kind in asked:
        file, pattern = candidates[kind]
        for path in sources.named(file):
            for member in archives.members(path):
                if re.search(pattern, member.name):
                    text = member.read().decode("ascii", "replace")
                    return poses.read(text, f"{path}: {member.name}", _OXFORD, p.fastest), kind
    files = " or ".join(candidates[kind][0] for kind in asked)
    raise DatasetError(f"{wanted}: no poses in {files}; poses=ins takes those of the car's own receiver")


def _images(sources: Sources, chunks: list[Path], places: dict[int, Position]) -> Iterator[Kept]:
    convert = _converter(sources)
    for path in chunks:
        for member in archives.members(path):
            match = _FRAME.search(member.name)
            if match and (position := places.get(int(match[2]))):
                yield Kept(
                    f"{match[2]}.png", match[2], position, lambda m=member, p=path: convert(m.read(), f"{p}: {m.name}")
                )


def _converter(sources: Sources) -> Callable[[bytes, str], bytes]:
    """A function from a raw mosaic, the bytes of a file, to those of a colour image."""
    cv2 = preparation.optional("cv2", "opencv-python-headless")
    width, height = sources.parameters.size
    table = None
    if sources.parameters.undistort:
        (path,) = sources.named(_MODEL)
        values, needed = np.fromfile(path, "<f8"), 2 * width * height
        if values.size != needed:
            raise DatasetError(f"{path}: {values.size:,} numbers; {width} × {height} pixels need {needed:,}")
        table = values.reshape(2, height, width).astype(np.float32)  # columns, then rows, both from zero

    def convert(content: bytes, where: str) -> bytes:
        try:
            with Image.open(io.BytesIO(content)) as image:
                mode, size, raw = image.mode, image.size, np.asarray(image)
        except (OSError, ValueError, SyntaxError) as error:
            raise DatasetError(f"{where}: cannot be decoded ({error}); get the archive again") from None
        if mode != "L" or size != (width, height):
            raise DatasetError(
                f"{where}: {size[0]} × {size[1]} pixels of mode {mode}; raw images of stereo/centre have {width} × {height} of "
                f"one channel"
            )
        colour = cv2.cvtColor(raw, cv2.COLOR_BayerGBRG2RGB)
        if table is not None:
            colour = cv2.remap(colour, table[0], table[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return preparation.as_png(colour)

    return convert
