"""For maintainers: choose how strong noise and condition are in made descriptors, so that R@1 and DAR@1 come near the paper's.

Run ``python tests/record_made.py`` after a change of ``artifact.extraction.made``, and commit ``made.csv``.
"""

import csv
import dataclasses
import functools
import sys
from pathlib import Path

from artifact import evaluate, manifest
from artifact.extraction import made
from artifact.extraction.made import Strength
from artifact.metrics.two_stage import evaluate_two_stage
from artifact.ranking import matching
from artifact.ranking.candidates import Images
from artifact.studies import reported

TARGET = Path(made.__file__).with_name("made.csv")


def measured(entry, method, two_stage, strength):
    """R@1 and DAR@1 in percent."""
    threshold = entry.threshold.value
    sides = {}
    for traversal in (entry.query, entry.database):
        along, positions = made.route(entry, traversal)
        descriptors = made.descriptors(entry, traversal, method, along, strength)
        sides[traversal] = (descriptors, positions, along)
    (queries, query_positions, _), (database, database_positions, _) = sides.values()
    if two_stage is None:
        result = evaluate(queries, database, query_positions, database_positions, threshold, device="cpu", draws=1)
    else:
        images = []
        for traversal, (descriptors, positions, along) in sides.items():
            second = made.descriptors(entry, traversal, method, along, strength, two_stage)
            pair = (second, descriptors) if two_stage == "codes" else (descriptors, second)
            images.append(Images.of(*pair, positions))
        scores = matching.cosines if two_stage == "codes" else matching.LocalMatcher(device="cpu")
        result = evaluate_two_stage(*images, threshold, scores, draws=1)
    return 100 * result.recall(1), 100 * result.dar(1)


def bisect(function, low, high, steps=9):
    """Find where a falling function crosses zero."""
    for _ in range(steps):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if function(middle) > 0 else (low, middle)
    return (low * high) ** 0.5


def chosen(of, recall, dar):
    """Set noise by R@1 and condition by DAR@1, in turn."""
    noise, condition = 1.0, 0.5
    for _ in range(3):
        noise = bisect(functools.partial(lambda c, x: of(Strength(x, c))[0] - recall, condition), 0.3, 12.0)
        condition = bisect(functools.partial(lambda n, x: of(Strength(n, x))[1] - dar, noise), 0.02, 12.0)
    return Strength(round(noise, 3), round(condition, 3))


def main():
    loaded = manifest.load()
    table = reported.table("fig05")
    rows = []
    for row in table.to_dict("records"):
        entry, method = loaded.dataset(row["dataset"]), loaded.method(row["method"])
        two_stage = None if method.rerank is None else "codes" if method.code_bits else "local"
        wanted = row["recall_percent"], row["dar_percent"]
        of = functools.partial(measured, entry, row["method"], two_stage)
        strength = chosen(of, *wanted)
        found = of(strength)
        rows.append({"dataset": row["dataset"], "method": row["method"], **dataclasses.asdict(strength)})
        shown = " ".join(f"{value:7.2f}" for pair in zip(found, wanted, strict=True) for value in pair)
        sys.stdout.write(f"{row['dataset']:14} {row['method']:12} {shown}\n")
        sys.stdout.flush()
    with TARGET.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=["dataset", "method", "noise", "condition"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
