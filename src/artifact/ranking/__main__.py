"""Compile ranking and fitting, so that notebooks that run side by side need not each: ``python -m artifact.ranking``."""

import time

import numpy as np

from artifact.ranking.one_pass import ImageSet, Options, rank
from artifact.suppression.inlp import INLP


def main() -> None:
    """Fit on a few made descriptors, and rank them in all the ways that a ranking can take."""
    rng, places = np.random.default_rng(0), np.column_stack([np.arange(40.0), np.zeros(40)])
    views = {"view": INLP(3).fit(rng.standard_normal((40, 16)), np.arange(40) % 2)}
    for dtype in (np.float32, np.float16):
        sets = [ImageSet(rng.standard_normal((40, 16)).astype(dtype), places) for _ in range(3)]
        options = Options(retrieve=3, view_sweeps=True, device="cpu")
        rank(sets[0], sets[1], 2.0, {"queries": None, "others": sets[2]}, views, options)


if __name__ == "__main__":
    began = time.monotonic()
    main()
    print(f"compiled ranking and fitting in {time.monotonic() - began:.0f} s")  # noqa: T201
