"""``artifact verify``: stored results against their sidecars, measurements against the paper."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from artifact import datasets, store, studies
from artifact.datasets import shipped
from artifact.manifest import Manifest
from artifact.methods import weights
from artifact.methods.weights import lock
from artifact.studies import reported


def verify(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    """Check what is stored, and compare what the profile measures with what the paper reports.

    Parameters
    ----------
    manifest, profile
        The profile's datasets and methods are compared where the paper has them; missing datasets are named.

    Returns
    -------
    lines
        What was checked, for the user.
    faults
        Number of damaged files, of changed weights and of measurements more than 1 percentage point from the paper's.
    """
    lines, damaged = _verify_files(manifest.cache)
    more, shipped_damaged = _verify_files(shipped.folder())
    weighed, changed = _verify_weights(manifest, profile)
    compared, different = _against_the_paper(manifest, profile)
    return [*lines, *more, *weighed, *compared], damaged + shipped_damaged + changed + different


def _verify_files(folder: Path) -> tuple[list[str], int]:
    """Recompute the digest of every stored array that has a sidecar."""
    checked, faults = 0, []
    for sidecar_path in sorted(folder.rglob("*.json")):
        arrays = [path for ending in (".npy", ".npz") if (path := sidecar_path.with_suffix(ending)).exists()]
        sidecar = store.read_json(sidecar_path) if arrays else {}
        for path in arrays:
            checked += 1
            if store.digest_of_file(path) != sidecar.get("sha256"):
                faults.append(f"DAMAGED {path}: its content differs from its sidecar; delete both and run again")
    return [f"{folder}: {checked} stored results, {len(faults)} damaged", *faults], len(faults)


def _verify_weights(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    """Recompute the digest of the profile's weights, whatever their modification time says."""
    checked, faults = 0, []
    for name in manifest.profile(profile).methods:
        entry = manifest.method(name).weights
        paths = [weights.path_of(entry, file) for file in entry.files] if entry else []
        for path in paths:
            if path.exists() and lock.path_of(path).exists():
                checked += 1
                if store.digest_of_file(path) != lock.read(path)["sha256"]:
                    faults.append(f"CHANGED   {path}: its content differs from its lock file; fetch it anew")
    return [f"{checked} files of weights, {len(faults)} changed", *faults] if checked else [], len(faults)


def _against_the_paper(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    entry = manifest.profile(profile)
    names = [name for name in entry.datasets if manifest.dataset(name).reported_as]
    methods = [name for name in entry.methods if name in reported.method_titles()]
    if not names or not methods:
        what = "dataset" if not names else "method"
        return [f"profile {profile!r} has no {what} of the paper: nothing to compare with its numbers"], 0
    lines, different = [], 0
    for name in names:
        missing = datasets.describe_missing(manifest, name)
        if missing:
            lines.append(f"MISSING   {name}: {missing.splitlines()[0]}")
            continue
        for row in studies.recall.recall_table(manifest, [name], methods).table.to_dict("records"):
            for metric in studies.common.METRICS:
                value = row[f"reported_{metric}"]
                judged = reported.verdict(row[metric], value, None if metric == "RSR" else row["queries"])
                different += judged == "different"
                shown = "–" if pd.isna(value) else f"{value:.2f}"
                lines.append(
                    f"{judged.upper():<9} {name} {row['method']} {metric}@1: {row[metric]:.2f} %, paper {shown} %"
                )
    return lines, different
