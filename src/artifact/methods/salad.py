"""SALAD (Izquierdo and Civera, CVPR 2024) and SALAD-CM, its training with Clique Mining (ECCV 2024).

Written from the papers. DINOv2 patch features are assigned to clusters by optimal transport, with a dustbin
for patches that tell nothing about the place; the summed features per cluster and a projection of the class
token are the descriptor.
"""

from __future__ import annotations

import math

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.dinov2 import feature_map, vit_base
from artifact.methods.blocks.inputs import PATCH, check_images

CLUSTERS = 64
_HIDDEN = 512
_TOKEN = 256
_ITERATIONS = 3


def assign_by_transport(scores: torch.Tensor, dustbin: torch.Tensor, iterations: int = _ITERATIONS) -> torch.Tensor:
    """Turn scores (b, m, n) of m clusters and n > m patches into shares of patches, with a dustbin (Sinkhorn).

    The transport plan over the clusters and the dustbin is exp(scores), its rows scaled to sum to 1 per cluster and n −
    m for the dustbin, then its columns to sum to 1 per patch, alternately. The columns come last, so their sums are
    exact. The dustbin's score is one constant, which scaling its row absorbs: it has no influence on the result.

    Examples
    --------
    >>> shares = assign_by_transport(torch.zeros(1, 2, 4), torch.tensor(0.0))
    >>> shares[0, :, 0]  # 2 of 4 patches' worth of mass stays in the dustbin
    tensor([0.2500, 0.2500])
    """
    clusters, patches = scores.shape[1:]
    plan = torch.cat((scores, dustbin.expand(len(scores), 1, patches)), dim=1)
    log_row_sums = scores.new_zeros(clusters + 1, 1)
    log_row_sums[-1] = math.log(patches - clusters)
    for _ in range(iterations):  # in logarithms, where large scores do not overflow
        plan = plan - plan.logsumexp(dim=2, keepdim=True) + log_row_sums
        plan = plan - plan.logsumexp(dim=1, keepdim=True)
    return plan[:, :-1].exp()


class OptimalTransportAggregator(nn.Module):
    """SALAD's aggregation of a feature map and a class token; per cluster, 128 channels in SALAD, 256 in MegaLoc."""

    def __init__(self, cluster_dimension: int) -> None:
        super().__init__()
        self.token_features = nn.Sequential(nn.Linear(768, _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, _TOKEN))
        self.cluster_features = _pointwise_perceptron(cluster_dimension)
        self.score = _pointwise_perceptron(CLUSTERS)
        self.dust_bin = nn.Parameter(torch.tensor(1.0))
        self.dimension = CLUSTERS * cluster_dimension + _TOKEN

    def forward(self, features: torch.Tensor, token: torch.Tensor) -> torch.Tensor:
        """Map features (b, 768, rows, columns) and class tokens (b, 768) to unit vectors (b, dimension)."""
        values = self.cluster_features(features).flatten(2)
        shares = assign_by_transport(self.score(features).flatten(2), self.dust_bin)
        sums = values @ shares.transpose(1, 2)  # (b, cluster dimension, clusters)
        clusters = functional.normalize(sums, dim=1).flatten(1)
        scene = functional.normalize(self.token_features(token), dim=1)
        return functional.normalize(torch.cat((scene, clusters), dim=1), dim=1)


def _pointwise_perceptron(out: int) -> nn.Sequential:
    # The identity keeps the place of the training's dropout, which the released keys count.
    return nn.Sequential(nn.Conv2d(768, _HIDDEN, 1), nn.Identity(), nn.ReLU(), nn.Conv2d(_HIDDEN, out, 1))


class SALAD(nn.Module):
    """SALAD with DINOv2 ViT-B/14, 64 clusters of 128 and a token of 256: 8448 dimensions; SALAD-CM is the same."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({"model": vit_base()})
        self.aggregator = OptimalTransportAggregator(128)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, h, w), multiples of 14, more than 64 patches: unit vectors (b, 8448), float32."""
        height, width = check_images(images, self, multiple=PATCH, more_patches_than=CLUSTERS)
        tokens = self.backbone["model"](images)
        return self.aggregator(feature_map(tokens, height, width), tokens[:, 0])
