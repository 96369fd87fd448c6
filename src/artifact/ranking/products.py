"""The first look: matrix products that are fast and known to be nearly right.

Each product of rows ``q`` and ``c`` comes with terms whose inner product bounds its error: ``|found - q·c| <=
as_query(q) · as_image(c)``.

- **float32.** A sum of ``n`` products in any order is off by at most ``γ_n |q| |c|`` with ``u = 2⁻²⁴`` (Higham 2002,
  eq. 3.5). Columns are multiplied 128 at a time where the library can add a product to another, which rounds no term
  more than ``128 + d / 128`` times: of d = 8,448 that is 43 times less, and as many fewer pairs to look at again. oneDNN
  compiles its product for the processor at hand and is the fastest on many; it takes only columns that lie side by side,
  so that they are copied, 2048 at a time.
- **bfloat16.** Rows are cut into parts that bfloat16 holds exactly, ``q = q₁ + δ`` or ``q = q₁ + q₂ + δ``, with the
  lengths of the remainders measured; the products of parts are exact in float32. What is left out is at most
  ``|δ_q| |c| + |q| |δ_c|`` (and ``|q₂| |c₂|``), by Cauchy and Schwarz. The processor is only told that it *may* use its
  matrix engine (AMX, tensor cores): should it take the values as float32 or TF32, nothing changes. Engines add with less
  care than processors (Fasi, Higham, Mikaitis, Pranesh 2021, *Numerical behavior of NVIDIA tensor cores*): their sums are
  taken to be good to ``2⁻²²`` a step.

Values below 2⁻¹²⁶ may be flushed to zero, which adds ``d 2⁻¹²⁶ (1 + |q|) (1 + |c|)``; of rows longer than 2⁶⁰ nothing is
claimed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np

_UNIT = 2.0**-24
_ENGINE_UNIT = 2.0**-22
_SMALLEST = 2.0**-126
_STEP, _ENGINE_STEP, _ONEDNN_STEP = 128, 512, 2048
_WIDENED = 2**21  # values that are cut into parts at a time
_PRECISION = threading.Lock()  # PyTorch's precision is one for all threads


class Product(Protocol):
    """A way to multiply blocks of rows."""

    @property
    def name(self) -> str:
        """Its name in reports."""

    def multiply(self, left: Any, right: Any, out: Any = None) -> Any:
        """Return ``left @ right.T`` in float32, of arrays, or of tensors if the product takes them, in ``out`` if given."""

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ``(n, t)`` terms of rows of known lengths as queries and as images."""


@dataclass(frozen=True)
class NumpyProduct:
    """NumPy's own float32 product."""

    name: str = "NumPy float32"

    def multiply(self, left: np.ndarray, right: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """See :class:`Product`."""
        with np.errstate(over="ignore", invalid="ignore"):  # of rows whose reach is infinite
            return np.matmul(left, right.T, out=out)

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        return _sums(rows.shape[1], rows.shape[1], _UNIT, length)


@dataclass(frozen=True)
class TorchProduct:
    """PyTorch's float32 product."""

    name: str = "PyTorch float32"

    def multiply(self, left: Any, right: Any, out: Any = None) -> Any:
        """See :class:`Product`."""
        with precision("highest"):
            return _in_steps(left, right, _STEP, out)

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        return _sums(rows.shape[1], _STEP, _UNIT, length)


@dataclass(frozen=True)
class OneDnnProduct:
    """oneDNN's float32 product, compiled for this processor; PyTorch has it and takes it only in compiled models."""

    name: str = "oneDNN float32"

    @staticmethod
    def available() -> bool:
        """Whether this build of PyTorch has it."""
        import torch

        has_it = torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        return has_it and hasattr(torch.ops.mkldnn, "_linear_pointwise")

    def multiply(self, left: Any, right: Any, out: Any = None) -> Any:
        """See :class:`Product`."""
        import torch

        total = None
        with precision("highest"):
            for columns in _steps(left.shape[1], _ONEDNN_STEP):
                # Of rows that lie side by side: others would go through a slow kernel.
                sides = left[:, columns].contiguous(), right[:, columns].contiguous()
                found = torch.ops.mkldnn._linear_pointwise(*sides, None, "none", [], "")
                total = found if total is None else total.add_(found)
        return total if out is None else out.copy_(total)

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        return _sums(rows.shape[1], _ONEDNN_STEP, _UNIT, length)


@dataclass(frozen=True)
class HalfProduct:
    """Products of one or two bfloat16 parts on a matrix engine."""

    parts: int

    @property
    def name(self) -> str:
        """Its name in reports."""
        return f"bfloat16, {'one product' if self.parts == 1 else 'three products'}"

    def multiply(self, left: Any, right: Any, out: Any = None) -> Any:
        """See :class:`Product`."""
        lefts, rights = _parts(left, self.parts), _parts(right, self.parts)
        with precision("medium"):
            out = _in_steps(lefts[0], rights[0], _ENGINE_STEP, out)
            for one, other in [(0, 1), (1, 0)] if self.parts == 2 else []:
                for columns in _steps(left.shape[1], _ENGINE_STEP):
                    out.addmm_(lefts[one][:, columns], rights[other][:, columns].T)
        return out

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        import torch

        last, rest = np.zeros(len(rows)), np.zeros(len(rows))
        step = max(1, _WIDENED // rows.shape[1])
        for start in range(0, len(rows), step):
            block = torch.from_numpy(np.ascontiguousarray(rows[start : start + step], np.float32))
            parts = _parts(block, self.parts)
            for out, part in ((last, parts[-1]), (rest, block - sum(parts))):
                out[start : start + step] = 1.001 * part.norm(dim=1).numpy()  # a sum in float32, rounded up
        sums = _sums(rows.shape[1], _ENGINE_STEP, 3 * _ENGINE_UNIT if self.parts == 2 else _ENGINE_UNIT, 1.01 * length)[
            0
        ]
        dropped = last[:, None] if self.parts == 2 else np.zeros((len(rows), 0))
        # The two terms of a remainder are of one size when each side is scaled by the root of the other's share.
        scale = 2.0 ** (-4 if self.parts == 1 else -8)
        fine, whole = rest[:, None] / scale, 1.01 * scale * length[:, None]
        return np.hstack([sums, dropped, fine, whole]), np.hstack([sums, dropped, whole, fine])


def _sums(d: int, step: int, unit: float, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return terms of sums by steps, and of what may be flushed to zero."""
    step = min(step, d)
    n = step + -(-d // step) + 2
    gamma = n * unit / (1 - n * unit)
    terms = np.stack([np.sqrt(gamma) * length, np.sqrt(d * _SMALLEST) * (1 + length)], axis=1)
    return terms, terms


def _steps(d: int, step: int) -> Iterator[slice]:
    for start in range(0, d, step):
        yield slice(start, min(start + step, d))


def multiply(product: Product, left: np.ndarray, right: np.ndarray, out: np.ndarray) -> None:
    """Write a product of arrays into an array, also by a product that takes tensors."""
    if isinstance(product, NumpyProduct):
        product.multiply(left, right, out)
        return
    import torch

    product.multiply(*map(torch.from_numpy, (left, right, out)))


def _in_steps(left: Any, right: Any, step: int, out: Any) -> Any:
    import torch

    first, *others = _steps(left.shape[1], step)
    out = torch.mm(left[:, first], right[:, first].T, out=out)
    for columns in others:
        out.addmm_(left[:, columns], right[:, columns].T)
    return out


def _parts(block: Any, parts: int) -> list[Any]:
    """Cut float32 values into a high and, for two parts, a low bfloat16 value, kept as float32."""
    import torch

    high = block.to(torch.bfloat16).float()
    return [high] if parts == 1 else [high, (block - high).to(torch.bfloat16).float()]


@contextmanager
def precision(name: str) -> Iterator[None]:
    """Set PyTorch's precision of float32 products for a while, for this thread alone."""
    import torch

    with _PRECISION:
        before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(name)
        try:
            yield
        finally:
            torch.set_float32_matmul_precision(before)


@cache
def seconds() -> dict[Product, float]:
    """Return the products that this processor has, with the seconds of a multiplication, measured once in a process."""
    import torch  # noqa: F401  # what loads now is not timed

    block = np.random.default_rng(0).standard_normal((1024, 1024), dtype=np.float32)
    out = np.empty_like(block)
    products: list[Product] = [NumpyProduct(), TorchProduct(), HalfProduct(1), HalfProduct(2)]
    products += [OneDnnProduct()] if OneDnnProduct.available() else []
    best = dict.fromkeys(products, np.inf)
    # Several times in a row, for the threads of the library before still turn for a while; and in two turns, so that other
    # work on the machine slows none alone. What is far behind has one.
    for turn in range(2):
        for product in tuple(best):
            if turn and best[product] > 3 * min(best.values()):
                continue
            for _ in range(5):
                start = time.perf_counter()
                multiply(product, block, block, out)
                best[product] = min(best[product], (time.perf_counter() - start) / block.size / len(block))
    return best


def measured() -> bool:
    """Whether this process knows :func:`seconds`."""
    return seconds.cache_info().currsize > 0
