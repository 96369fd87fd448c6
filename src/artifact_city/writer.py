"""Write the images and positions of a traversal to a folder, whole or not at all."""

import csv
import os
import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from PIL import Image

from artifact_city.traversal import CityTraversal, positions, render_frame

JPEG_QUALITY = 90


def render(
    traversal: CityTraversal,
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Render all images of a traversal to ``folder``: ``000000.jpg`` ... and ``positions.csv``.

    Works in a temporary folder beside the target and renames it at the end, so that a run that is stopped leaves
    nothing that looks complete. The bytes do not depend on the number of workers.

    Parameters
    ----------
    traversal : CityTraversal
    folder : path
        Must not exist yet.
    workers : int, optional
        Threads; default: one per processor.
    progress : callable, optional
        Called with the number of images done, after each one.

    Raises
    ------
    FileExistsError
        If ``folder`` exists.
    ValueError
        If the route has no room for the frames.
    """
    folder = Path(folder)
    if folder.exists():
        raise FileExistsError(f"{folder} exists already; delete it to render it anew")
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers!r}")
    where = positions(traversal)
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", suffix=".partial", dir=folder.parent))
    try:
        render_frame(traversal, 0)  # builds and compiles what all frames share before several threads want it at once
        names = [f"{index:06d}.jpg" for index in range(traversal.frames)]
        with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
            jobs = [pool.submit(_write_frame, traversal, k, temporary / name) for k, name in enumerate(names)]
            try:
                for done, job in enumerate(as_completed(jobs), start=1):
                    job.result()
                    if progress is not None:
                        progress(done)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        _write_positions(temporary / "positions.csv", names, where, traversal.positions)
        temporary.chmod(0o755)
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _write_frame(traversal: CityTraversal, index: int, path: Path) -> None:
    Image.fromarray(render_frame(traversal, index)).save(path, quality=JPEG_QUALITY, subsampling=1)


def _write_positions(path: Path, names: list[str], where: np.ndarray, unit: str) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        if unit == "frames":
            table.writerow(["image", "index"])
            table.writerows([name, int(p[0])] for name, p in zip(names, where, strict=True))
        else:
            table.writerow(["image", "x", "y"])
            table.writerows([name, f"{x:.3f}", f"{y:.3f}"] for name, (x, y) in zip(names, where, strict=True))
