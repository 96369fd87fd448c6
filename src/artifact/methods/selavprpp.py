"""SelaVPR++ (Lu et al., TPAMI 2025), large: hash codes for retrieval, descriptors for re-ranking.

A frozen DINOv2 ViT-L/14 feeds two branches of sixteen adapters each. One ends in a descriptor of 4096
floats, the other in a hash code of 512 bits. Candidates are found by the Hamming distance of the codes and
ranked by the descriptors.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.adapters import MultiScaleAdapter
from artifact.methods.blocks.dinov2 import VisionTransformer, feature_map
from artifact.methods.blocks.inputs import PATCH, check_images
from artifact.methods.blocks.pooling import unit_gem

_WIDTH = 1024
_DEPTH = 24
_ADAPTERS = 16  # one after each of the last sixteen blocks


class _BranchedTransformer(VisionTransformer):
    def __init__(self) -> None:
        super().__init__(_WIDTH, _DEPTH, 16)
        self.adapters = nn.ModuleList(MultiScaleAdapter(_WIDTH) for _ in range(_ADAPTERS))
        self.adapters_hashing = nn.ModuleList(MultiScaleAdapter(_WIDTH) for _ in range(_ADAPTERS))

    def branches(self, images: torch.Tensor, adapters: Sequence[nn.ModuleList]) -> list[torch.Tensor]:
        """Map images (b, 3, h, w) to one tensor of normalised tokens (b, 1 + n, 1024) per branch."""
        grid = (images.shape[-2] // PATCH, images.shape[-1] // PATCH)
        tokens = self.encode(images, -_ADAPTERS)
        states = [tokens] * len(adapters)
        for index, block in enumerate(self.blocks[-_ADAPTERS:]):
            tokens = block(tokens)
            states = [s + branch[index](s + tokens, grid) for s, branch in zip(states, adapters, strict=True)]
        return [self.norm(state) for state in states]


class SelaVPRPlusPlus(nn.Module):
    """SelaVPR++ with DINOv2 ViT-L/14: 4096 dimensions, and hash codes of 512 bits."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = _BranchedTransformer()
        self.aggregation = unit_gem()
        self.linear1 = nn.Linear(_WIDTH, _WIDTH)
        self.linear2 = nn.Linear(_WIDTH, 4096)
        self.aggregation_hashing = unit_gem()
        self.linear3 = nn.Linear(_WIDTH, _WIDTH)
        self.linear4 = nn.Linear(_WIDTH, 512)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe square images (b, 3, h, h), h a multiple of 14: unit vectors (b, 4096), float32; no hash codes."""
        return self._heads(images)[0]

    def descriptors_and_codes(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what `forward` does, and hash codes of +1 and −1 (b, 512), int8.

        The Hamming distance of two codes is (512 − their dot product) / 2.
        """
        descriptors, values = self.descriptors_and_hash_values(images)
        return descriptors, torch.where(values >= 0, 1, -1).to(torch.int8)

    def descriptors_and_hash_values(self, images: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the descriptors (b, 4096) and the unit vectors (b, 512) whose signs are the hash codes."""
        return self._heads(images, hashing=True)

    def _heads(self, images: torch.Tensor, *, hashing: bool = False) -> tuple[torch.Tensor, ...]:
        side = check_images(images, self, multiple=PATCH, square=True)[0]
        heads = [(self.backbone.adapters, self.linear1, self.aggregation, self.linear2)]
        if hashing:
            heads += [(self.backbone.adapters_hashing, self.linear3, self.aggregation_hashing, self.linear4)]
        branches = self.backbone.branches(images, [adapters for adapters, *_ in heads])
        return tuple(
            functional.normalize(last(pool(feature_map(first(tokens), side, side))), dim=1)
            for tokens, (_, first, pool, last) in zip(branches, heads, strict=True)
        )
