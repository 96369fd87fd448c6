"""What a whole run takes for each method and dataset: measured rates, scaled by the known complexity of each step.

The counts of fits and passes are those of the pages of the book: Table III and Figs. 2, 5 to 7 (ranking), Figs. 3, 8 to
10 and Tables IV and V (suppression, of single-stage methods alone). Pages beyond the paper take little beside them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from artifact.commands.probes import INLP_ITERATIONS
from artifact.extraction import local_features
from artifact.extraction.costs import ExtractionCost
from artifact.manifest import Manifest
from artifact.manifest.entries import MethodEntry
from artifact.studies.verdicts import FRACTIONS

Rates = Mapping[str, float | None]

FRACTION = 0.1
"""Share of the queries that all studies but Fig. 10 fit on."""

STEPS = ("extraction", "ranking", "INLP", "LEACE", "suppressed", "probe", "UMAP")
"""Steps of a run; ``suppressed`` is the ranking of suppressed descriptors, with the passes of STD."""

_PROCESS = 0.5e9  # bytes of Python and the libraries
_TILES = 2**28  # bytes of a pass's similarity tiles
_SLICE = 4096  # columns of the descriptors that sums widen to float64 at a time, twice
_KEPT = 600  # bytes of a query's counts on disk, and in each further view or pool
_UMAP_EPOCHS, _UMAP_FEW_EPOCHS, _UMAP_MANY = 500, 200, 10_000
_CANDIDATES_OF_BOTH = 2  # database and augmented database give a query at most twice the candidates


@dataclass(frozen=True)
class Step:
    """What one of :data:`STEPS` takes for one method and dataset.

    ``seconds`` are ``None`` if they are unknown; ``memory`` is the peak in bytes of the process, without descriptors that are
    mapped from disk, and ``disk`` the bytes that it leaves there.
    """

    name: str
    seconds: float | None
    memory: float = 0.0
    disk: float = 0.0


@dataclass(frozen=True)
class PairCost:
    """All steps of one method on one dataset, in the order of :data:`STEPS`; steps that it has not are left out."""

    method: str
    dataset: str
    steps: tuple[Step, ...]

    @property
    def memory(self) -> float:
        """Peak bytes over all steps."""
        return max(step.memory for step in self.steps)

    @property
    def disk(self) -> float:
        """Bytes that all steps leave on disk."""
        return sum(step.disk for step in self.steps)


@dataclass(frozen=True)
class Pair:
    """Sizes of one method on one dataset: numbers of ``queries`` and ``database`` images, ``dimension`` of their descriptors.

    ``pools`` is the number of further distractor pools (Fig. 7), ``further_pairs`` that of query–database pairs that no
    transform is fitted on (Table V); ``mixed`` says whether the maps mix a database (Figs. 2 and 9), ``embedded`` whether
    Fig. 3 shows this pair.
    """

    queries: int
    database: int
    dimension: int
    pools: int = 0
    mixed: bool = False
    further_pairs: int = 0
    embedded: bool = False

    def at(self, share: float) -> Pair:
        """Return the pair of a region with a share of the images."""
        return Pair(math.ceil(share * self.queries), math.ceil(share * self.database), self.dimension)

    @property
    def images(self) -> int:
        """Queries and database images."""
        return self.queries + self.database

    @property
    def bytes(self) -> float:
        """Bytes of the descriptors in float32."""
        return 4.0 * self.images * self.dimension


def sizes(
    manifest: Manifest, method: str, dataset: str, images: Mapping[str, int | None], *, embedded: bool = False
) -> Pair:
    """Return the sizes of a pair from the ``images`` of each traversal; unknown numbers count as none."""
    entry = manifest.dataset(dataset)
    return Pair(
        images.get(entry.query) or 0,
        images.get(entry.database) or 0,
        manifest.method(method).dimension,
        pools=len(entry.distractor_traversals),
        mixed=entry.same_condition_traversal is not None,
        further_pairs=len(entry.irrelevant_pairs),
        embedded=embedded,
    )


def pair_cost(pair: Pair, entry: MethodEntry, extraction: ExtractionCost, rates: Rates) -> PairCost:
    """Return what all steps of a pair take; two-stage methods have no suppression. Where a rate is missing, time is unknown."""
    steps = [Step("extraction", extraction.seconds, extraction.memory or 0.0, extraction.disk)]
    measured = defaultdict(lambda: math.nan, {name: value for name, value in rates.items() if value is not None})
    if entry.rerank is not None:
        steps.append(_two_stage(pair, entry, measured))
    else:
        steps += [_ranking(pair, measured), *_suppression(pair, measured)]
    known = (replace(step, seconds=None) if math.isnan(step.seconds or 0.0) else step for step in steps)
    return PairCost(extraction.method, extraction.dataset, tuple(known))


def pass_seconds(pair: Pair, rates: Mapping[str, float], views: int = 0, columns: int = 0) -> float:
    """Return the seconds of one ranking pass; distractors are the queries, half of whose pairs symmetry leaves.

    ``views`` are low-rank views, which project on so many ``columns`` together.
    """
    pairs = pair.queries * pair.database + pair.queries**2 / 2
    projected = pair.images * columns * pair.dimension * rates["product"]
    return pairs * (pair.dimension * rates["product"] + rates["pair"] + views * rates["view"]) + projected


def _ranking(pair: Pair, rates: Mapping[str, float]) -> Step:
    one = pass_seconds(pair, rates)
    # Fig. 7 ranks against each pool, and symmetry leaves none of their pairs out; Fig. 2 ranks two databases.
    pooled = (1 + pair.pools) * pair.queries**2 * (pair.dimension * rates["product"] + rates["pair"])
    seconds = one + (one + pooled if pair.pools else 0) + (2 * one if pair.mixed else 0)
    passes = 1 + (1 + pair.pools if pair.pools else 0) + (2 if pair.mixed else 0)
    return Step("ranking", seconds, _PROCESS + _TILES, passes * _KEPT * pair.queries)


def _two_stage(pair: Pair, entry: MethodEntry, rates: Mapping[str, float]) -> Step:
    layout, candidates = local_features.layout_of(entry), entry.rerank or 0
    if layout is None or layout.bits:
        first = pass_seconds(Pair(pair.queries, pair.database, 0), rates)
        score, draws, at_work = pair.dimension * rates["cosine"], 10, pair.bytes
    else:
        first = pass_seconds(pair, rates)
        score, draws, at_work = rates[f"match {layout.shape}"], 3, 2.0**30
    scored = pair.queries * min(_CANDIDATES_OF_BOTH * candidates, pair.images)
    if pair.pools:  # Fig. 7, and the sweeps of Fig. 6: each random order has its own candidates
        candidates_of_order = candidates * (1 + math.log(max(1, pair.queries / candidates)))
        scored += pair.queries * candidates * (1 + pair.pools) + (draws + 1) * pair.queries * candidates_of_order
    return Step("ranking", first + scored * score, _PROCESS + _TILES + at_work, _KEPT * pair.queries)


def _suppression(pair: Pair, rates: Mapping[str, float]) -> Iterator[Step]:
    """Yield the fits of INLP and LEACE, the passes on what they leave, the guardedness probes and UMAP."""
    region, half = pair.at(1 - FRACTION), pair.at(0.5)
    # Fig. 8 fits once, Table IV once alone and once after the other datasets.
    fits = dict.fromkeys(FRACTIONS, 1) | {FRACTION: 4}
    inlp_fits = fits | {FRACTION: 4 + pair.mixed + pair.embedded}
    transforms = 2 * 2 * 8.0 * pair.dimension  # both sides of two kept maps of Table IV, float64
    for name, fit, number, directions in (("INLP", _inlp, inlp_fits, INLP_ITERATIONS), ("LEACE", _leace, fits, 1)):
        taken = {fraction: fit(pair.at(fraction), rates) for fraction in FRACTIONS}
        seconds = sum(number[fraction] * seconds for fraction, (seconds, _) in taken.items())
        yield Step(name, seconds, max(memory for _, memory in taken.values()), transforms * directions)
    both = INLP_ITERATIONS + 1
    standardised = pass_seconds(region, rates) + len(FRACTIONS) * pass_seconds(half, rates)
    rescaled = (region.images + len(FRACTIONS) * half.images) * pair.dimension * rates["scale"]
    # Fig. 8; Table IV with the single and the composed map of either method; Table V; Fig. 9; Fig. 10.
    viewed = (1 + 2 + pair.further_pairs + pair.mixed) * pass_seconds(region, rates, 2, 2 * both)
    grown = pass_seconds(half, rates, 2 * len(FRACTIONS), len(FRACTIONS) * both)
    yield Step(
        "suppressed",
        viewed + grown + standardised + rescaled,
        _PROCESS + _TILES + 2 * region.bytes,
        (1 + 4 + 2 * len(FRACTIONS)) * _KEPT * pair.queries,
    )
    rows = min(region.queries, region.database)  # of both conditions in one half, to train on; as many to test on
    rate = rates["probe_dual" if rows < pair.dimension else "probe_primal"]
    # The training images, transformed; with fewer of them than columns the factor of their Gram matrix, its copy and the
    # solver's with an index for each value that is not zero, else float64 and the solver's copy of the images themselves.
    solver = 24.0 * rows**2 if rows < pair.dimension else 24.0 * rows * pair.dimension
    yield Step("probe", rows * pair.dimension * rate, _PROCESS + 4.0 * rows * pair.dimension + solver)
    if pair.embedded:
        epochs = _UMAP_EPOCHS if region.images <= _UMAP_MANY else _UMAP_FEW_EPOCHS
        seconds = 2 * region.images * epochs * rates["umap"]
        yield Step("UMAP", seconds, _PROCESS + 3 * region.bytes, 16.0 * region.images)


def _inlp(at: Pair, rates: Mapping[str, float]) -> tuple[float, float]:
    """Seconds, and bytes: Gram matrix or coordinates, and eigenvectors; or the rows in float64 and as much room to work."""
    n, d = at.images, at.dimension
    factored = n**2 * d * rates["gram"] + n**3 * rates["eigen"] if n < d else 0.0
    memory = _PROCESS + at.bytes + 8.0 * n * (2 * n + 2 * _SLICE if n < d else 2 * d)
    return factored + INLP_ITERATIONS * n * min(n, d) * rates["inlp"], memory


def _leace(at: Pair, rates: Mapping[str, float]) -> tuple[float, float]:
    """Seconds, and bytes: Gram matrix and its eigenvectors; or the centred rows with their scatter matrix."""
    n, d = at.images, at.dimension
    memory = _PROCESS + at.bytes + 8.0 * (2 * n * (n + _SLICE) if n < d else 2 * n * d + 3 * d * d)
    return n * d * min(n, d) * rates["gram"] + min(n, d) ** 3 * rates["eigen"], memory


def that_do_not_fit(
    costs: Sequence[PairCost], memory: float, disk: float
) -> Iterator[tuple[PairCost, Step, str, float, float]]:
    """Yield pairs and steps for which memory or disk does not suffice, with ``"memory"`` or ``"disk"``, bytes needed and there.

    Disk is filled in the order of the costs; what does not fit is passed over.
    """
    left = disk
    for cost in costs:
        for step in cost.steps:
            if step.memory > memory:
                yield cost, step, "memory", step.memory, memory
            if step.disk > left:
                yield cost, step, "disk", step.disk, left
            else:
                left -= step.disk
