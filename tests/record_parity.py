"""Measure the equality with the authors' models that the parity tests assert, and record it for the book.

For maintainers: ``python tests/record_parity.py`` writes ``src/artifact/methods/parity.csv``; a test holds the file to the
limits and to the list of methods.
"""

import csv
import platform
from pathlib import Path

import numpy as np
import torch
from filled_weights import filled, images
from test_methods_parity import METHODS, golden, unused_by_anyloc

from artifact import store
from artifact.methods.anyloc import vlad

TARGET = Path(__file__).resolve().parents[1] / "src" / "artifact" / "methods" / "parity.csv"
COLUMNS = ("method", "output", "images", "compared", "max_abs", "max_l2", "limit_abs", "limit_l2", "torch", "machine")
UNIT = (1e-6, 1e-5)  # limits of unit-length outputs: largest difference of a value, and of a whole vector


def differences(found, expected):
    difference = np.abs(found.double().numpy() - expected.astype(np.float64))
    return difference.max(), np.linalg.norm(difference.reshape(len(difference), -1), axis=1).max(), difference.size


def outputs(name):
    """Yield each output with what the official model gave for the same weights and images."""
    method, expected = METHODS[name], golden(name)
    batch = images(method.size, method.size)
    if name == "anyloc":
        model = filled(method.build, unused_by_anyloc)
        yield (
            "descriptors, every 16th value",
            vlad(model.features(batch), model.c_centers)[:, ::16],
            expected["descriptors_every_16th"],
            UNIT,
        )
        return
    model = filled(method.build)
    if name == "selavpr":
        descriptors, local = model.global_and_local(batch)
        yield "descriptors", descriptors, expected["descriptors"], UNIT
        yield (
            "local features, every 64th",
            local.reshape(2, -1, 128)[:, ::64],
            expected["local_every_64th"],
            (1e-5, None),
        )
    elif name == "selavprpp":
        descriptors, values = model.descriptors_and_hash_values(batch)
        yield "descriptors", descriptors, expected["descriptors"], UNIT
        yield "hash values", values, expected["hash_values"], UNIT
        yield "binary codes", torch.where(values >= 0, 1.0, -1.0), expected["codes"].astype(np.float32), (0.0, 0.0)
    else:
        yield "descriptors", model(batch), expected["descriptors"], UNIT
        if name == "cricavpr":
            alone = torch.cat([model(image[None]) for image in batch])
            yield "descriptors, batches of one image", alone, expected["descriptors_alone"], UNIT


def main():
    rows = []
    for name in METHODS:
        with torch.inference_mode():
            for output, found, expected, (limit_abs, limit_l2) in outputs(name):
                largest, length, count = differences(found, expected)
                limits = [f"{limit:g}" if limit is not None else "" for limit in (limit_abs, limit_l2)]
                size = f"{METHODS[name].size}x{METHODS[name].size}"
                machine = f"{platform.system()} {platform.machine()}"
                rows.append(
                    [
                        name,
                        output,
                        f"2 of {size}",
                        count,
                        f"{largest:.2e}",
                        f"{length:.2e}",
                        *limits,
                        torch.__version__.split("+")[0],
                        machine,
                    ]
                )
                print(*rows[-1])  # noqa: T201
    with store.replacing(TARGET) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(rows)


if __name__ == "__main__":
    main()
