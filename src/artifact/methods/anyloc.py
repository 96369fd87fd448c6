"""AnyLoc (Keetha et al., RA-L 2024): VLAD over features of DINOv2 ViT-g/14, with no training for the task.

The feature of a patch is its value vector in the attention of the 32nd block. The vocabulary is a separate
file of 32 cluster centres; the one for urban places is meant here.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.dinov2 import GatedPerceptron, VisionTransformer
from artifact.methods.blocks.inputs import PATCH, check_images

_WIDTH = 1536
_CLUSTERS = 32
_LAYER = 31  # counted from 0, of 40 blocks


def vlad(features: torch.Tensor, centres: torch.Tensor) -> torch.Tensor:
    """Aggregate unit features (b, n, c) to unit vectors (b, k · c) by VLAD (Jégou et al., CVPR 2010), assigned hard.

    Each feature goes to the centre of largest cosine similarity. The residuals from the centre itself (not scaled to
    unit length) are summed per cluster, the sums scaled to unit length (none: zeros), and again their concatenation.
    The sum of residuals is the sum of the features less count times centre, so no residual is ever stored.

    Examples
    --------
    >>> vlad(torch.tensor([[[1.0, 0.0], [0.8, 0.6]]]), torch.tensor([[0.5, 0.0], [0.0, 1.0]]))
    tensor([[0.8000, 0.6000, 0.0000, 0.0000]])
    """
    nearest = (features @ functional.normalize(centres, dim=1).T).argmax(dim=2)
    assigned = functional.one_hot(nearest, len(centres)).to(features.dtype).transpose(1, 2)
    residuals = assigned @ features - assigned.sum(dim=2, keepdim=True) * centres
    return functional.normalize(functional.normalize(residuals, dim=2).flatten(1), dim=1)


class AnyLoc(VisionTransformer):
    """AnyLoc with DINOv2 ViT-g/14, the value vectors of block 32 and 32 clusters: 49152 dimensions, 4.5 GB.

    The state dict is Meta's ``dinov2_vitg14`` checkpoint plus the vocabulary ``c_centers`` (32, 1536). The last eight
    blocks and the final normalisation are in it but have no influence on the descriptor and are not run.
    """

    def __init__(self) -> None:
        super().__init__(_WIDTH, 40, 24, feed_forward=GatedPerceptron)
        self.c_centers = nn.Parameter(torch.zeros(_CLUSTERS, _WIDTH))

    def features(self, images: torch.Tensor) -> torch.Tensor:
        """Map images (b, 3, h, w) to the unit value vectors of the patches (b, h / 14 · w / 14, 1536)."""
        tokens, block = self.encode(images, _LAYER), self.blocks[_LAYER]
        weight, bias = block.attn.qkv.weight[-_WIDTH:], block.attn.qkv.bias[-_WIDTH:]
        values = functional.linear(block.norm1(tokens[:, 1:]), weight, bias)
        return functional.normalize(values, dim=2)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, h, w), h and w multiples of 14: unit vectors (b, 49152), float32."""
        check_images(images, self, multiple=PATCH)
        return vlad(self.features(images), self.c_centers)
