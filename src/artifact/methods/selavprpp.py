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
from artifact.methods.blocks.untrained import untrained

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
        tokens = self.embed(images)
        for block in self.blocks[:-_ADAPTERS]:
            tokens = block(tokens)
        states = [tokens] * len(adapters)
        for index, block in enumerate(self.blocks[-_ADAPTERS:]):
            tokens = block(tokens)
            states = [
                state + branch[index](state + tokens, grid) for state, branch in zip(states, adapters, strict=True)
            ]
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
        """Describe square images (b, 3, h, h), h a multiple of 14: unit vectors (b, 4096), float32.

        The hashing branch is not computed.

        Raises
        ------
        ValueError
            If shape, size, dtype or device do not fit.
        """
        side = self._check(images)
        (tokens,) = self.backbone.branches(images, [self.backbone.adapters])
        return self._describe(tokens, side)

    def descriptors_and_codes(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Describe square images (b, 3, h, h) for both stages, in one pass.

        Returns
        -------
        descriptors : torch.Tensor
            What `forward` returns, shape (b, 4096).
        codes : torch.Tensor
            Hash codes of +1 and −1, shape (b, 512), int8. The Hamming distance of two is (512 − their dot
            product) / 2.

        Raises
        ------
        ValueError
            If shape, size, dtype or device do not fit.
        """
        descriptors, values = self.descriptors_and_hash_values(images)
        return descriptors, torch.where(values >= 0, 1, -1).to(torch.int8)

    def descriptors_and_hash_values(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the descriptors (b, 4096) and the unit vectors (b, 512) whose signs are the hash codes."""
        side = self._check(images)
        adapters = [self.backbone.adapters, self.backbone.adapters_hashing]
        tokens, hashing_tokens = self.backbone.branches(images, adapters)
        return self._describe(tokens, side), self._hash_values(hashing_tokens, side)

    def _check(self, images: torch.Tensor) -> int:
        return check_images(images, self, multiple=PATCH, square=True)[0]

    def _describe(self, tokens: torch.Tensor, side: int) -> torch.Tensor:
        pooled = self.aggregation(feature_map(self.linear1(tokens), side, side))
        return functional.normalize(self.linear2(pooled), dim=1)

    def _hash_values(self, tokens: torch.Tensor, side: int) -> torch.Tensor:
        pooled = self.aggregation_hashing(feature_map(self.linear3(tokens), side, side))
        return functional.normalize(self.linear4(pooled), dim=1)


def selavprpp() -> SelaVPRPlusPlus:
    """Build SelaVPR++ (large, 4096 dimensions and 512 bits) without trained weights, in eval mode."""
    return untrained(SelaVPRPlusPlus)
