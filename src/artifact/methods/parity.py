"""How far each architecture's outputs lie from those of its authors' model, with the same weights and images.

The parity tests compare every output with values that the authors' own code gave for weights and images that follow a
written recipe (``tests/golden/README.md``). The record is what the tests' maintainers measured with the same code.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd


def recorded() -> pd.DataFrame:
    """Return one row per method and output.

    Columns are ``method``, ``output``, ``images``, ``compared`` (number of values), ``max_abs`` (largest difference of
    a value), ``max_l2`` (largest length of the difference of one image's output), the tests' limits, ``torch``,
    ``machine``.
    """
    return pd.read_csv(Path(__file__).with_name("parity.csv"))
