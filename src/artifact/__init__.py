"""Distractor-augmented evaluation and condition suppression of visual place recognition descriptors.

Data flows one way, through one folder for each stage; nothing imports from a later one:

``manifest`` (what there is) → ``store`` (what persists) → ``datasets`` (files to traversals) → ``methods`` (images to
descriptors) → ``extraction`` (traversals to descriptors on disk) → ``suppression`` (INLP, LEACE, STD) → ``ranking`` (one
pass to per-query counts) → ``metrics`` (R@K, DAR@K, RSR@K) → ``studies`` (one function per table and figure) → ``pages``
(tables, figures and findings as a reader sees them) → ``book`` (notebooks to pages) → ``commands`` (the command line).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from artifact import methods
    from artifact.metrics.evaluate import evaluate
    from artifact.metrics.evaluation import Evaluation
    from artifact.suppression.inlp import INLP
    from artifact.suppression.leace import LEACE
    from artifact.suppression.loading import load_transform
    from artifact.suppression.lowrank import LowRankMap, compose
    from artifact.suppression.probe import probe
    from artifact.suppression.regions import fit_region, split
    from artifact.suppression.std import STD

__version__ = "1.0.0"
__all__ = [
    "INLP",
    "LEACE",
    "STD",
    "Evaluation",
    "LowRankMap",
    "compose",
    "evaluate",
    "fit_region",
    "load_transform",
    "methods",
    "probe",
    "split",
]

_HOMES = {
    "suppression.inlp": ["INLP"],
    "suppression.leace": ["LEACE"],
    "suppression.std": ["STD"],
    "suppression.lowrank": ["LowRankMap", "compose"],
    "suppression.probe": ["probe"],
    "suppression.regions": ["fit_region", "split"],
    "suppression.loading": ["load_transform"],
    "metrics.evaluate": ["evaluate"],
    "metrics.evaluation": ["Evaluation"],
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the numerical libraries take seconds to import."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"artifact.{home}"), name)
    if name == "methods":
        return import_module("artifact.methods")
    raise AttributeError(f"module 'artifact' has no attribute {name!r}")
