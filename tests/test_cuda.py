"""What only a CUDA device can show: the same descriptors, the same counts and the same matches as on the CPU."""

from __future__ import annotations

import gc

import numpy as np
import pandas as pd
import pytest
import torch
from filled_weights import filled, images
from test_methods_parity import METHODS, golden, unused_by_anyloc

from artifact import INLP, LEACE, evaluate
from artifact.extraction import forward
from artifact.ranking.matching import match_count

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device; this machine has none")
CUDA = torch.device("cuda")
RUN = [name for name in METHODS if name not in ("salad_cm", "anyloc")]


def places(n_queries, n_database, flipped):
    """Two traversals of one road whose images differ in some signs; their inner products are exact in float32."""
    rng = np.random.default_rng(n_queries)
    road = rng.choice([-0.125, 0.125], (max(n_queries, n_database), 64)).astype(np.float32)
    queries, database = (road[:n] * np.where(rng.random((n, 64)) < flipped, -1, 1) for n in (n_queries, n_database))
    where = (np.column_stack([np.arange(n) * 4.0, np.zeros(n)]) for n in (n_queries, n_database))
    return queries.astype(np.float32), database.astype(np.float32), *where


@pytest.mark.parametrize("name", RUN)
def test_descriptors_equal_the_official_ones(name):
    method = METHODS[name]
    model = filled(method.build).to(CUDA)
    with forward.numerics(CUDA, "float32"):
        found = model(images(method.size, method.size).to(CUDA)).cpu().double()
    assert (found - torch.as_tensor(golden(name)["descriptors"]).double()).norm(dim=-1).max() <= 2e-5
    del model
    gc.collect()
    torch.cuda.empty_cache()


def test_anyloc_equals_the_official_one():
    model = filled(METHODS["anyloc"].build, unused_by_anyloc).to(CUDA)
    with forward.numerics(CUDA, "float32"):
        found = model(images(METHODS["anyloc"].size, METHODS["anyloc"].size).to(CUDA)).cpu()
    expected = torch.as_tensor(golden("anyloc")["descriptors_every_16th"])
    assert (found[:, ::16] - expected).norm(dim=-1).max() <= 2e-5
    torch.cuda.empty_cache()


def test_half_precision_stays_near_and_of_unit_length():
    model = filled(METHODS["salad"].build).to(CUDA)
    batch = images(METHODS["salad"].size, METHODS["salad"].size).to(CUDA)
    with forward.numerics(CUDA, "float32"):
        exact = model(batch)
    with forward.numerics(CUDA, "bfloat16"):
        near = torch.nn.functional.normalize(model(batch).float(), dim=-1)
    similarity = (exact * near).sum(dim=-1)
    assert 0.99 < similarity.min() < 1 - 1e-7


@pytest.mark.parametrize("memory", [2**20, 2**30])
def test_counts_equal_those_of_the_cpu(memory):
    arguments = places(700, 900, 0.15)
    here, there = (
        evaluate(*arguments, 25.0, similarity="dot", retrieve=7, draws=3, depth=12, memory=memory, device=device)
        for device in ("cpu", "cuda")
    )
    for distractors in (False, True):
        for ties in ("for", "against"):
            ranks = [result.ranks(distractors=distractors, ties=ties) for result in (here, there)]
            np.testing.assert_array_equal(*ranks)
    pd.testing.assert_frame_equal(here.per_query(), there.per_query())
    distances = [25.0, 100.0, np.inf]
    np.testing.assert_array_equal(here.dar_by_distance(distances), there.dar_by_distance(distances))


def test_views_rank_as_on_the_cpu():
    queries, database, *where = places(500, 600, 0.15)
    rows, condition = np.vstack([queries, database]), np.repeat(["night", "day"], [500, 600])
    views = {"LEACE": LEACE().fit(rows, condition), "INLP": INLP(n_iterations=5).fit(rows, condition)}
    here, there = (evaluate(queries, database, *where, 25.0, views=views, device=device) for device in ("cpu", "cuda"))
    for name in views:
        for k in (1, 10):
            # Rounding may turn a near-tie: one query at most.
            assert abs(here[name].dar(k) - there[name].dar(k)) <= 1 / 500 + 1e-12
            assert abs(here[name].recall(k) - there[name].recall(k)) <= 1 / 500 + 1e-12


def test_match_counts_equal_those_of_the_cpu():
    rng = np.random.default_rng(2)
    features = torch.from_numpy(rng.integers(-2, 3, (3, 20, 20, 16)).astype(np.float32))
    on_cpu, on_cuda = (match_count(features[0].to(d), features.to(d)).cpu() for d in ("cpu", CUDA))
    assert torch.equal(on_cpu, on_cuda)
