"""The first look: matrix products that are fast and known to be nearly right.

Each product of rows ``q`` and ``c`` comes with terms whose inner product bounds its error: ``|found - q·c| <=
as_query(q) · as_image(c)``.

- **float32.** A sum of ``n`` products in any order is off by at most ``γ_n |q| |c|`` with ``u = 2⁻²⁴`` (Higham 2002,
  eq. 3.5). Steps of some columns are multiplied by themselves and added, which rounds no term more often than a step has
  columns and there are steps: with 512 columns at a time, of d = 8,448, that is 16 times less, and as many fewer pairs to
  look at again. PyTorch adds a product to another on the way; NumPy cannot, so that its steps are long. It multiplies
  rows with themselves at half the price. oneDNN compiles its product for the processor at hand and is the fastest on
  many; it takes only columns that lie side by side, so that they are copied, 2048 at a time.
- **bfloat16.** Rows are rounded to what bfloat16 holds, ``q = q₁ + δ``, with the length of the remainder measured; the
  products of such values are exact in float32. What is left out is at most ``|δ_q| |c| + |q₁| |δ_c|``, by Cauchy and
  Schwarz. The processor is only told that it *may* use its matrix engine (AMX, tensor cores): should it take the values
  as float32 or TF32, nothing changes. Engines add with less care than processors (Fasi, Higham, Mikaitis, Pranesh 2021,
  *Numerical behavior of NVIDIA tensor cores*): their sums are taken to be good to ``2⁻²²`` a step.
- **int8.** Processors multiply whole numbers of eight bits four times as fast as float32 (VNNI, AMX), and their sums in
  int32 are exact. Rows are cut into two such parts, ``q = s (q₁ + q₂ / 256) + δ`` with a scale of its own, and three
  products of parts are taken; the fourth, at most ``|q₂| |c₂|`` in length, and the remainders are left out, with lengths
  that are measured. Only joining the three rounds, by ``γ_4`` of what they hold.

Values below 2⁻¹²⁶ may be flushed to zero, which adds ``d 2⁻¹²⁶ (1 + |q|) (1 + |c|)``; of rows longer than 2⁶⁰ nothing is
claimed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np

from artifact.ranking.arithmetic import ANY_ORDER
from artifact.suppression.compiled import compiled, threads

_UNIT = 2.0**-24
_ENGINE_UNIT = 2.0**-22
_SMALLEST = 2.0**-126
_STEP, _ONEDNN_STEP, _NUMPY_STEP, _INTEGER_STEP = 512, 2048, 4096, 2**15
_WIDENED = 2**21  # values that are widened at a time
_SHORTEST = np.float32(2.0**-118)  # the largest value of a row that has a scale
_MOST_COLUMNS = 2**16  # sums of as many products of both parts are below 2³¹
_PRECISION = threading.Lock()  # PyTorch's precision is one for all threads


class Product(Protocol):
    """A way to multiply blocks of rows."""

    @property
    def name(self) -> str:
        """Its name in reports."""

    def prepared(self, rows: Any) -> Any:
        """Return float32 rows, an array or a tensor, as the product multiplies them."""

    def multiply(self, left: Any, right: Any, out: np.ndarray | None = None) -> Any:
        """Return ``left @ right.T`` of prepared rows in float32, in ``out`` if given."""

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ``(n, t)`` terms of rows of known lengths as queries and as images."""


@dataclass(frozen=True)
class NumpyProduct:
    """NumPy's own float32 product, in few steps that are equally long."""

    name: str = "NumPy float32"

    def prepared(self, rows: np.ndarray) -> np.ndarray:
        """See :class:`Product`."""
        return rows

    def multiply(self, left: np.ndarray, right: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """See :class:`Product`."""
        first, *others = _steps(left.shape[1], _numpy_step(left.shape[1]))
        with np.errstate(over="ignore", invalid="ignore"):  # of rows whose reach is infinite
            total = np.matmul(left[:, first], right[:, first].T, out=out)
            for some in others:
                total += left[:, some] @ right[:, some].T
        return total

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        return _sums(rows.shape[1], _numpy_step(rows.shape[1]), _UNIT, length)


@dataclass(frozen=True)
class TorchProduct:
    """PyTorch's float32 product, ``step`` columns at a time."""

    name: str = "PyTorch float32"
    step: int = _STEP

    def prepared(self, rows: Any) -> Any:
        """See :class:`Product`."""
        return _tensor(rows)

    def multiply(self, left: Any, right: Any, out: np.ndarray | None = None) -> Any:
        """See :class:`Product`."""
        with precision("highest"):
            return _in_steps(left, right, self.step, out)

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        return _sums(rows.shape[1], self.step, _UNIT, length)


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

    def prepared(self, rows: Any) -> list[Any]:
        """See :class:`Product`: some columns after the other, for rows must lie side by side."""
        return [_tensor(rows)[:, some].contiguous() for some in _steps(rows.shape[1], _ONEDNN_STEP)]

    def multiply(self, left: list[Any], right: list[Any], out: np.ndarray | None = None) -> Any:
        """See :class:`Product`."""
        import torch

        total = None
        with precision("highest"):
            for sides in zip(left, right, strict=True):
                found = torch.ops.mkldnn._linear_pointwise(*sides, None, "none", [], "")
                total = found if total is None else total.add_(found)
        return total if out is None else _tensor(out).copy_(total)

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        return _sums(rows.shape[1], _ONEDNN_STEP, _UNIT, length)


@dataclass(frozen=True)
class HalfProduct:
    """The product of values rounded to bfloat16, on a matrix engine."""

    name: str = "bfloat16"

    def prepared(self, rows: Any) -> Any:
        """See :class:`Product`; the values are kept as float32, which an engine takes for what they are."""
        import torch

        return _tensor(rows).to(torch.bfloat16).float()

    def multiply(self, left: Any, right: Any, out: np.ndarray | None = None) -> Any:
        """See :class:`Product`."""
        with precision("medium"):
            return _in_steps(left, right, _STEP, out)

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        rest = np.empty(len(rows))

        def measure(some: slice, block: np.ndarray) -> None:
            # A sum in float32, rounded up.
            rest[some] = 1.001 * (_tensor(block) - self.prepared(block)).norm(dim=1).numpy()

        _over_blocks(measure, rows)
        sums = _sums(rows.shape[1], _STEP, _ENGINE_UNIT, 1.01 * length)[0]
        return _with_remainders(sums, rest, length, 2.0**-5)


@dataclass(frozen=True)
class IntegerProduct:
    """Three products of int8 parts, whose sums are exact."""

    name: str = "int8, three products"

    @staticmethod
    def available() -> bool:
        """Whether PyTorch has it, and its sums are exact here: processors without VNNI may cut large ones off."""
        import torch

        if not hasattr(torch, "_int_mm"):
            return False
        left, right = np.random.default_rng(0).choice(np.array([-127, 127], np.int8), (2, 64, 1024))
        left[:32] = right[:32] = 127
        exact = left.astype(np.float64) @ right.astype(np.float64).T
        return np.array_equal(_whole(_tensor(left), _tensor(right)), exact)

    def prepared(self, rows: np.ndarray) -> tuple[Any, np.ndarray]:
        """See :class:`Product`: the high, the low and again the high parts, side by side, and the scales."""
        n, d = rows.shape
        parts, scale = np.empty((n, 3 * d), np.int8), np.empty(n, np.float32)
        _in_threads(lambda some: _cut(rows[some], parts[some], scale[some]), n)
        return _tensor(parts), scale

    def multiply(self, left: Any, right: Any, out: np.ndarray | None = None) -> np.ndarray:
        """See :class:`Product`."""
        (ours, our_scale), (theirs, their_scale) = left, right
        d = ours.shape[1] // 3
        high, low = _whole(ours[:, :d], theirs[:, :d]), _whole(ours[:, : 2 * d], theirs[:, d:])
        found = np.empty(high.shape, np.float32) if out is None else out
        _join(high, low, our_scale, their_scale, found)
        return found

    def terms(self, rows: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Product`."""
        n, d = rows.shape
        low, rest = np.empty(n), np.empty(n)
        _over_blocks(lambda some, block: _left_out(block, low[some], rest[some]), rows)
        if d > _MOST_COLUMNS:
            rest[:] = np.inf
        sums = _rounding(4, d, _UNIT, length + 2 * low + rest)[0]
        return _with_remainders(np.hstack([sums, low[:, None]]), rest, length, 2.0**-7)


def _whole(left: Any, right: Any) -> np.ndarray:
    """Return ``left @ right.T`` of int8 in int32, in steps that stay below 2³¹ with what an engine may add to values."""
    import torch

    first, *others = (torch._int_mm(left[:, some], right[:, some].T) for some in _steps(left.shape[1], _INTEGER_STEP))
    for other in others:
        first += other
    return np.asarray(first)


@compiled()
def _scale_of(row: np.ndarray) -> tuple[np.float32, np.float32]:
    """Return the scale of a row's high parts, and what to multiply by for it: zeros if the row is too short for one."""
    largest = np.float32(0)
    for column in range(row.size):
        largest = max(largest, abs(row[column]))
    if largest < _SHORTEST:
        return np.float32(0), np.float32(0)
    return largest / np.float32(127), np.float32(127) / largest


@compiled()
def _high_and_low(value: np.float32, times: np.float32) -> tuple[np.float32, np.float32]:
    scaled = value * times
    high = np.rint(scaled)
    return high, min(np.float32(127), np.rint((scaled - high) * np.float32(256)))


@compiled()
def _cut(rows: np.ndarray, parts: np.ndarray, scale: np.ndarray) -> None:
    n, d = rows.shape
    for row in range(n):
        scale[row], times = _scale_of(rows[row])
        values, first, low, second = rows[row], parts[row, :d], parts[row, d : 2 * d], parts[row, 2 * d :]
        for column in range(d):
            whole, fraction = _high_and_low(values[column], times)
            first[column] = second[column] = np.int8(whole)
            low[column] = np.int8(fraction)


@compiled(fastmath=ANY_ORDER)
def _left_out(rows: np.ndarray, low: np.ndarray, rest: np.ndarray) -> None:
    """Write the lengths of the low parts and of what is in neither part."""
    for row in range(rows.shape[0]):
        scale, times = _scale_of(rows[row])
        values, lows, rests = rows[row], 0.0, 0.0
        for column in range(values.size):
            whole, fraction = _high_and_low(values[column], times)
            left = np.float64(values[column]) - np.float64(scale) * (np.float64(whole) + np.float64(fraction) / 256)
            lows += np.float64(fraction) * np.float64(fraction)
            rests += left * left
        low[row], rest[row] = 1.001 * np.float64(scale) * np.sqrt(lows) / 256, 1.001 * np.sqrt(rests)


@compiled()
def _join(high: np.ndarray, low: np.ndarray, left: np.ndarray, right: np.ndarray, out: np.ndarray) -> None:
    for row in range(out.shape[0]):
        line, whole, fraction, scale = out[row], high[row], low[row], left[row]
        for column in range(line.size):
            together = np.float32(whole[column]) + np.float32(fraction[column]) * np.float32(1 / 256)
            line[column] = together * scale * right[column]


def _sums(d: int, step: int, unit: float, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return terms of sums by steps, and of what may be flushed to zero."""
    step = min(step, d)
    return _rounding(step + -(-d // step) + 2, d, unit, length)


def _rounding(n: int, d: int, unit: float, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return terms of what is rounded ``n`` times, and of what may be flushed to zero."""
    gamma = n * unit / (1 - n * unit)
    terms = np.stack([np.sqrt(gamma) * length, np.sqrt(d * _SMALLEST) * (1 + length)], axis=1)
    return terms, terms


def _with_remainders(
    terms: np.ndarray, rest: np.ndarray, length: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Add the terms of ``|δ_q| |c| + (|q| + |δ_q|) |δ_c|``, of one size where ``scale²`` is the share of a remainder."""
    fine, whole = rest[:, None] / scale, scale * (length + rest)[:, None]
    return np.hstack([terms, fine, whole]), np.hstack([terms, whole, fine])


def _in_threads(work: Callable[[slice], None], n: int, step: int | None = None) -> None:
    """Do some work with the rows of a block, a part in each thread."""
    with threads() as executor:
        step = step or -(-n // executor._max_workers)
        list(executor.map(lambda start: work(slice(start, min(start + step, n))), range(0, n, step)))


def _over_blocks(work: Callable[[slice, np.ndarray], None], rows: np.ndarray) -> None:
    """Do some work with blocks of rows, in float32."""
    step = max(1, _WIDENED // rows.shape[1])
    _in_threads(lambda some: work(some, np.ascontiguousarray(rows[some], np.float32)), len(rows), step)


def _tensor(rows: Any) -> Any:
    import torch

    return torch.from_numpy(rows) if isinstance(rows, np.ndarray) else rows


def _steps(d: int, step: int) -> Iterator[slice]:
    for start in range(0, d, step):
        yield slice(start, min(start + step, d))


def _numpy_step(d: int) -> int:
    """Return the longest step of NumPy's that makes all steps of ``d`` columns nearly as long."""
    return -(-d // -(-d // _NUMPY_STEP))


def _in_steps(left: Any, right: Any, step: int, out: np.ndarray | None) -> Any:
    import torch

    first, *others = _steps(left.shape[1], step)
    total = torch.mm(left[:, first], right[:, first].T, out=_tensor(out))
    for columns in others:
        total.addmm_(left[:, columns], right[:, columns].T)
    return total


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


def every() -> list[Product]:
    """Return the products that this machine has."""
    some: list[Product] = [NumpyProduct(), TorchProduct(), HalfProduct()]
    return some + [kind() for kind in (OneDnnProduct, IntegerProduct) if kind.available()]


@cache
def seconds() -> dict[Product, float]:
    """Return the products that are fast here, with the seconds of a multiplication, measured once in a process."""
    import torch  # noqa: F401  # what loads now is not timed

    # Some are a hundred times slower where the processor has nothing for them.
    best = _timed(every(), 128, 1024)
    return _timed([product for product in best if best[product] <= 5 * min(best.values())], 448, 6144)


def _timed(some: Sequence[Product], n: int, d: int) -> dict[Product, float]:
    """Return the seconds of a multiplication in products of ``n`` rows with nearly as many others, as tiles have them."""
    rows = np.random.default_rng(0).standard_normal((2 * n - 1, d), dtype=np.float32)
    out = np.empty((n, len(rows)), np.float32)[:, n:]  # some libraries are slow where it isn't all of an array
    sides = {product: (product.prepared(rows[:n]), product.prepared(rows[n:])) for product in some}
    best = dict.fromkeys(some, np.inf)
    # Several times in a row, for the threads of the library before still turn for a while; and in two turns, so that other
    # work on the machine slows none alone.
    for product in 2 * list(some):
        for _ in range(4):
            start = time.perf_counter()
            product.multiply(*sides[product], out)
            best[product] = min(best[product], (time.perf_counter() - start) / (out.size * d))
    return best


def measured() -> bool:
    """Whether this process knows :func:`seconds`."""
    return seconds.cache_info().currsize > 0
