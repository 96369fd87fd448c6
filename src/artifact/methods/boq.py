"""BoQ, Bag of Queries (Ali-bey et al., CVPR 2024), with DINOv2.

Each of two blocks refines the patch features by a transformer encoder layer; 64 learnt queries then attend
to them. A linear map over all 128 answers gives the descriptor.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.attention import EncoderLayer, MultiHeadAttention
from artifact.methods.blocks.dinov2 import feature_map, vit_base
from artifact.methods.blocks.inputs import PATCH, check_images

_WIDTH = 384
_HEADS = 6
_QUERIES = 64
_BLOCKS = 2
_ROWS = 32


class _QueryBlock(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.queries = nn.Parameter(torch.zeros(1, _QUERIES, _WIDTH))
        self.encoder = EncoderLayer(_WIDTH, _HEADS, 4 * _WIDTH)
        self.self_attn = MultiHeadAttention(_WIDTH, _HEADS)
        self.norm_q = nn.LayerNorm(_WIDTH)
        self.cross_attn = MultiHeadAttention(_WIDTH, _HEADS)
        self.norm_out = nn.LayerNorm(_WIDTH)

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Map features (b, n, 384) to the refined features and the queries' answers (b, 64, 384)."""
        x = self.encoder(x)
        queries = self.norm_q(self.queries + self.self_attn(self.queries, self.queries))
        answers = self.cross_attn(queries.expand(len(x), -1, -1), x)
        return x, self.norm_out(answers)


class BoQ(nn.Module):
    """BoQ with DINOv2 ViT-B/14 (without its last normalisation) and two blocks of 64 queries: 12288 dimensions."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({"dino": vit_base()})
        self.aggregator = nn.ModuleDict(
            {
                "proj_c": nn.Conv2d(768, _WIDTH, 3, padding=1),
                "norm_input": nn.LayerNorm(_WIDTH),
                "boqs": nn.ModuleList(_QueryBlock() for _ in range(_BLOCKS)),
                "fc": nn.Linear(_BLOCKS * _QUERIES, _ROWS),
            }
        )

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, h, w), h and w multiples of 14: unit vectors (b, 12288), float32."""
        height, width = check_images(images, self, multiple=PATCH)
        tokens = self.backbone["dino"].encode(images)
        features = self.aggregator["proj_c"](feature_map(tokens, height, width))
        x = self.aggregator["norm_input"](features.flatten(2).transpose(1, 2))
        answers = []
        for block in self.aggregator["boqs"]:
            x, answer = block(x)
            answers.append(answer)
        rows = self.aggregator["fc"](torch.cat(answers, dim=1).transpose(1, 2))
        return functional.normalize(rows.flatten(1), dim=1)
