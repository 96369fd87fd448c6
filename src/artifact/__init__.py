"""Distractor-augmented evaluation and condition suppression of visual place recognition descriptors."""

from artifact.lowrank import LowRankMap, compose
from artifact.metrics import Evaluation, evaluate
from artifact.splits import fit_region
from artifact.suppression import INLP, LEACE, STD

__version__ = "1.0.0"
__all__ = ["INLP", "LEACE", "STD", "Evaluation", "LowRankMap", "compose", "evaluate", "fit_region"]
