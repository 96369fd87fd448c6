"""Mutual nearest local features in PyTorch, on any device."""

from __future__ import annotations

import torch


def match_count(query: torch.Tensor, candidates: torch.Tensor, *, block: int = 1) -> torch.Tensor:
    """Count the mutual nearest neighbours between a query's local features and each candidate's: SelaVPR's second stage.

    There is no threshold and no geometry; like the authors' code it gives 0 where there is exactly one match.

    Parameters
    ----------
    query
        Features of unit length, ``(rows, columns, c)`` or ``(m, c)``.
    candidates
        The same of k images, with k leading.
    block
        Candidates compared at a time; each takes m · n similarities (55 MB in float32 for 61 × 61 features).

    Examples
    --------
    >>> features = torch.eye(5)
    >>> match_count(features[:4], torch.stack([features, features.flip(0)]))
    tensor([4, 4])
    """
    if query.ndim < 2 or candidates.ndim < 3 or query.shape[-1] != candidates.shape[-1]:
        raise ValueError(
            "match_count takes query features (rows, columns, c) or (m, c) and candidates' features with one "
            f"more leading axis and the same c; found {tuple(query.shape)} and {tuple(candidates.shape)}."
        )
    if block < 1:
        raise ValueError(f"match_count takes a block of at least 1 candidate; found {block}.")
    query = query.flatten(0, -2)
    scores = [_mutual(query, some) for some in torch.split(candidates.flatten(1, -2), block)]
    return torch.cat(scores) if scores else torch.zeros(0, dtype=torch.int64, device=query.device)


def _mutual(query: torch.Tensor, candidates: torch.Tensor) -> torch.Tensor:
    similarities = candidates @ query.T  # (k, n, m)
    of_query = similarities.argmax(dim=1)
    of_candidates = similarities.argmax(dim=2)
    there_and_back = of_candidates.gather(1, of_query)
    counts = (there_and_back == torch.arange(len(query), device=query.device)).sum(dim=1)
    return torch.where(counts == 1, 0, counts)
