"""Distractor-augmented evaluation and condition suppression of visual place recognition descriptors."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from artifact import methods
    from artifact.metrics import Evaluation, evaluate
    from artifact.suppression.inlp import INLP
    from artifact.suppression.leace import LEACE
    from artifact.suppression.lowrank import LowRankMap, compose
    from artifact.suppression.regions import fit_region
    from artifact.suppression.std import STD

__version__ = "1.0.0"
__all__ = ["INLP", "LEACE", "STD", "Evaluation", "LowRankMap", "compose", "evaluate", "fit_region", "methods"]

_HOMES = {
    "INLP": "suppression.inlp", "LEACE": "suppression.leace", "STD": "suppression.std", "LowRankMap": "suppression.lowrank",
    "compose": "suppression.lowrank",
    "Evaluation": "metrics", "evaluate": "metrics", "fit_region": "suppression.regions",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the numerical libraries take seconds to import."""
    if name in _HOMES:
        return getattr(import_module(f"artifact.{_HOMES[name]}"), name)
    if name == "methods":
        return import_module("artifact.methods")
    raise AttributeError(f"module 'artifact' has no attribute {name!r}")
