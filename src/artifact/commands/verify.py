"""``artifact verify``: stored results against their sidecars, measurements against the paper."""

from __future__ import annotations

from pathlib import Path

from artifact import datasets, store
from artifact.datasets import shipped
from artifact.manifest import Manifest
from artifact.methods import weights
from artifact.methods.weights import lock
from artifact.studies import reported, verdicts


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
        Number of damaged files, of changed weights and of measurements that differ from the paper's.
    """
    lines, damaged = _verify_files(manifest.cache)
    more, shipped_damaged = _verify_files(shipped.folder())
    weighed, changed = _verify_weights(manifest, profile)
    compared, different = _compare(manifest, profile)
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


def _compare(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    """Print the verdict on every number of the paper that the profile measures."""
    entry = manifest.profile(profile)
    comparable = [name for name in entry.datasets if manifest.dataset(name).reported_as]
    methods = [name for name in entry.methods if name in reported.method_titles()]
    if not comparable or not methods:
        what = "dataset" if not comparable else "method"
        return [f"profile {profile!r} has no {what} of the paper: nothing to compare with its numbers"], 0
    lines, ready = [], []
    for name in comparable:
        missing = datasets.describe_missing(manifest, name)
        if missing:
            lines.append(f"MISSING   {name}: {missing.splitlines()[0]}")
        else:
            ready.append(name)
    found = verdicts.of_profile(manifest, ready, methods)
    for row in found.to_dict("records"):
        lines.append(
            f"{row['verdict'].upper():<11} {row['where']} · {row['dataset']} · {row['method']} · {row['quantity']}: "
            f"{row['measured']:.2f}, paper {row['reported']} ({row['why']})"
        )
    counts = verdicts.tally([found])
    lines.append(", ".join(f"{number} {verdict}" for verdict, number in counts.items()))
    return lines, counts["differs"]
