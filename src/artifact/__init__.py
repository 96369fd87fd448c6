"""Distractor-augmented evaluation and condition suppression of visual place recognition descriptors."""

from artifact.metrics import Evaluation, evaluate

__version__ = "1.0.0"
__all__ = ["Evaluation", "evaluate"]
