"""The eleven architectures: equality with the official models, and the mathematics of their parts."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from filled_weights import filled, images, weight
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn
from torch.nn import functional

from artifact import methods
from artifact.methods.anyloc import vlad
from artifact.methods.blocks.adapters import MultiScaleAdapter
from artifact.methods.blocks.attention import EncoderLayer, MultiHeadAttention
from artifact.methods.blocks.dinov2 import GatedPerceptron, SelfAttention, feature_map, interpolate_positions
from artifact.methods.blocks.pooling import GeM, unit_gem
from artifact.methods.megaloc import resize_to_patches
from artifact.methods.salad import assign_by_transport
from artifact.ranking.matching import match_count

GOLDEN = Path(__file__).parent / "golden"
REPEATABLE = settings(max_examples=50, deadline=None, derandomize=True)


@dataclass(frozen=True)
class Method:
    """What the tests know of a method; `probe` names the module whose output the golden file samples."""

    build: Callable[[], nn.Module]
    dimension: int
    size: int
    probe: str
    as_map: bool = False
    slow: bool = False
    golden: str = ""


METHODS = {
    "cosplace": Method(partial(methods.build, "cosplace"), 1024, 224, "backbone"),
    "eigenplaces": Method(partial(methods.build, "eigenplaces"), 2048, 224, "backbone"),
    "mixvpr": Method(partial(methods.build, "mixvpr"), 4096, 320, "backbone.model"),
    "salad": Method(partial(methods.build, "salad"), 8448, 322, "backbone.model.norm", as_map=True),
    "salad_cm": Method(
        partial(methods.build, "salad_cm"), 8448, 322, "backbone.model.norm", as_map=True, golden="salad"
    ),
    "megaloc": Method(partial(methods.build, "megaloc"), 8448, 322, "backbone.norm", as_map=True),
    "boq": Method(partial(methods.build, "boq"), 12288, 322, "backbone.dino.blocks.11", as_map=True),
    "cricavpr": Method(partial(methods.build, "cricavpr"), 10752, 224, "backbone.norm"),
    "selavpr": Method(partial(methods.build, "selavpr"), 1024, 224, "backbone.norm", slow=True),
    "selavprpp": Method(partial(methods.build, "selavprpp"), 4096, 322, "backbone.norm", slow=True),
    "anyloc": Method(partial(methods.build, "anyloc"), 49152, 112, "", slow=True),
}
EVERY_METHOD = pytest.mark.parametrize("name", METHODS)
# SALAD-CM is SALAD with other weights: there is nothing more to run.
RUN = [pytest.param(n, marks=pytest.mark.slow) if m.slow else n for n, m in METHODS.items() if n != "salad_cm"]


def golden(name: str) -> dict[str, np.ndarray]:
    with np.load(GOLDEN / f"{METHODS[name].golden or name}.npz") as arrays:
        return dict(arrays)


def released_shapes(name: str) -> dict[str, tuple[int, ...]]:
    """Keys and shapes of a released checkpoint, the ranges of its compact listing written out."""
    listing = json.loads((GOLDEN / "state_dicts.json").read_text())[METHODS[name].golden or name]
    shapes = {}
    for pattern, shape in listing.items():
        literals = re.split(r"\{\d+\.\.\d+\}", pattern)
        ranges = [range(int(a), int(b) + 1) for a, b in re.findall(r"\{(\d+)\.\.(\d+)\}", pattern)]
        for numbers in itertools.product(*ranges):
            key = "".join(f"{text}{number}" for text, number in zip(literals, [*numbers, ""], strict=True))
            shapes[key] = tuple(shape)
    return shapes


def unused_by_anyloc(key: str) -> bool:
    """Weights of ViT-g behind the value projection of its 32nd block, and the mask token."""
    index = int(key.split(".")[1]) if key.startswith("blocks.") else None
    behind = re.match(r"blocks\.31\.(attn\.proj|ls1|norm2|mlp|ls2)\.", key)
    return key == "mask_token" or key.startswith("norm.") or bool(behind) or (index is not None and index > 31)


@dataclass(frozen=True)
class Run:
    """A filled model and what it makes of the golden images, with a two-stage method's second output."""

    name: str
    model: nn.Module
    images: torch.Tensor
    descriptors: torch.Tensor
    backbone: torch.Tensor
    second: torch.Tensor | None


@pytest.fixture(scope="module")
def run(request: pytest.FixtureRequest) -> Run:
    """One model at a time: pytest groups the tests by this parameter and frees the model before the next."""
    name, method = request.param, METHODS[request.param]
    model = filled(method.build, unused_by_anyloc) if name == "anyloc" else filled(method.build)
    batch, outputs, second = images(method.size, method.size), [], None
    if name == "anyloc":
        outputs.append(model.features(batch))
        return Run(name, model, batch, vlad(outputs[0], model.c_centers), outputs[0], second)
    hook = model.get_submodule(method.probe).register_forward_hook(lambda *call: outputs.append(call[2]))
    if name == "selavpr":
        descriptors, second = model.global_and_local(batch)
    elif name == "selavprpp":
        descriptors, second = model.descriptors_and_hash_values(batch)
    else:
        descriptors = model(batch)
    hook.remove()
    return Run(name, model, batch, descriptors, outputs[0], second)


def runs_of(*names: str) -> pytest.MarkDecorator:
    """Run a test on the filled models of these names."""
    chosen = [p for p in RUN if (p if isinstance(p, str) else p.values[0]) in names]
    return pytest.mark.parametrize("run", chosen, indirect=True)


def assert_descriptors_equal(found: torch.Tensor, expected: np.ndarray | torch.Tensor) -> None:
    difference = found.double() - torch.as_tensor(expected).double()
    assert difference.abs().max() <= 1e-6
    assert difference.norm(dim=-1).max() <= 1e-5


# --- equality with the official models ---


@runs_of(*METHODS)
def test_backbone_equals_the_official_one(run):
    expected, output = golden(run.name), run.backbone
    if METHODS[run.name].as_map:
        output = feature_map(output, *expected["size"])
    elif METHODS[run.name].probe.endswith("norm"):
        output = output[:, 1:]
    sample = output.reshape(2, -1)[:, :: int(expected["backbone_stride"])].numpy()
    assert np.abs(sample - expected["backbone"]).max() <= 2e-5 * np.abs(expected["backbone"]).max()


@runs_of(*METHODS)
def test_descriptors_equal_the_official_ones(run):
    assert run.descriptors.shape == (2, METHODS[run.name].dimension)
    assert run.descriptors.dtype == torch.float32
    assert not run.descriptors.requires_grad
    assert (run.descriptors.norm(dim=1) - 1).abs().max() <= 1e-6
    if run.name == "anyloc":
        assert_descriptors_equal(run.descriptors[:, ::16], golden("anyloc")["descriptors_every_16th"])
    else:
        assert_descriptors_equal(run.descriptors, golden(run.name)["descriptors"])


@runs_of(*set(METHODS) - {"cricavpr"})
def test_descriptor_does_not_depend_on_the_batch(run):
    assert_descriptors_equal(run.model(run.images[1:]), run.descriptors[1:])


@runs_of("cricavpr")
def test_cricavpr_depends_on_the_batch_but_not_on_its_order(run):
    alone = torch.cat([run.model(image[None]) for image in run.images])
    assert_descriptors_equal(alone, golden("cricavpr")["descriptors_alone"])
    assert (alone * run.descriptors).sum(dim=1).max() < 0.99
    assert_descriptors_equal(run.model(run.images.flip(0)).flip(0), run.descriptors)


@runs_of("selavpr")
def test_selavpr_local_features_and_scores_equal_the_official_ones(run):
    expected, local = golden("selavpr"), run.second
    assert local.shape == (2, 61, 61, 128)
    sample = local.reshape(2, 3721, 128)[:, ::64]
    assert np.abs(sample.numpy() - expected["local_every_64th"]).max() <= 1e-5

    scores = torch.stack([match_count(query, local) for query in local]).numpy()
    assert np.abs(scores - expected["match_counts"]).max() <= 2  # near ties may fall either way
    assert (scores.diagonal() == 61 * 61).all()
    grid = local[:, ::4, ::3]
    scores = torch.stack([match_count(query, grid, block=2) for query in grid]).numpy()
    assert np.abs(scores - expected["match_counts_of_grid"]).max() <= 2


@runs_of("selavprpp")
def test_selavprpp_hash_values_and_codes_equal_the_official_ones(run):
    expected = golden("selavprpp")
    assert_descriptors_equal(run.second, expected["hash_values"])
    assert np.array_equal(np.where(run.second >= 0, 1, -1), expected["codes"])

    small = images(28, 28)
    descriptors, codes = run.model.descriptors_and_codes(small)
    assert codes.dtype == torch.int8
    assert np.array_equal(codes, np.where(run.model.descriptors_and_hash_values(small)[1] >= 0, 1, -1))
    assert_descriptors_equal(descriptors, run.model(small))


@runs_of("anyloc")
def test_anyloc_assigns_patches_as_the_official_model(run):
    cosines = functional.cosine_similarity(run.backbone[:, :, None], run.model.c_centers[None, None], dim=3)
    assert np.array_equal(cosines.argmax(dim=2).numpy(), golden("anyloc")["clusters"])


@pytest.mark.parametrize("name", [n for n in METHODS if n != "salad_cm"])
def test_synthetic_weights_and_images_follow_the_recipe(name):
    expected, shapes = golden(name), released_shapes(name)
    for key, values in zip(expected["weight_probe_keys"], expected["weight_probe"], strict=True):
        assert np.array_equal(np.resize(weight(str(key), shapes[str(key)]).numpy(), 4), values)
    batch = images(*expected["size"]).reshape(-1)
    sample = batch[:: max(1, len(batch) // 64)][:64]
    assert np.abs(sample.numpy() - expected["image_probe"]).max() <= 1e-6


# --- construction ---


@EVERY_METHOD
def test_state_dict_and_output_have_the_released_shapes(name):
    with torch.device("meta"):
        model = METHODS[name].build()
    state = model.state_dict()
    assert {key: tuple(tensor.shape) for key, tensor in state.items()} == released_shapes(name)
    for key, tensor in state.items():
        assert tensor.is_meta
        assert tensor.dtype == (torch.int64 if key.endswith("num_batches_tracked") else torch.float32)
    assert not any(module.training or isinstance(module, nn.Dropout) for module in model.modules())
    assert not any(parameter.requires_grad for parameter in model.parameters())
    size = METHODS[name].size
    assert model(torch.empty(3, 3, size, size, device="meta")).shape == (3, METHODS[name].dimension)


def test_salad_cm_has_the_architecture_of_salad():
    with torch.device("meta"):
        assert str(methods.build("salad_cm")) == str(methods.build("salad"))


@pytest.mark.parametrize("name", ["mixvpr", "salad"])
def test_an_untrained_model_is_reproducible_and_finite(name):
    before = torch.get_rng_state()
    first, second = methods.build(name), methods.build(name)
    assert torch.equal(torch.get_rng_state(), before)
    for (key, a), b in zip(first.state_dict().items(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b), key
    size = 320 if name == "mixvpr" else 126
    descriptors = first(images(size, size))
    assert (descriptors.norm(dim=1) - 1).abs().max() <= 1e-6
    assert (descriptors[0] - descriptors[1]).norm() > 1e-3


@EVERY_METHOD
def test_normalisation_layers_have_the_epsilons_of_the_official_models(name):
    with torch.device("meta"):
        model = METHODS[name].build()
    for path, module in model.named_modules():
        if isinstance(module, nn.LayerNorm):  # DINOv2: 1e-6; aggregations: PyTorch's default
            assert module.eps == (1e-5 if path.startswith(("aggregator.", "encoder.")) else 1e-6), path
        elif isinstance(module, nn.BatchNorm2d):
            assert module.eps == (1e-3 if "adapter" in path else 1e-5), path


# --- input checks ---

MULTIPLE = "positive multiples of 14 pixels; found height 100, width 126"
BAD_SIZES = [
    *((n, (100, 126), MULTIPLE) for n in ("salad", "salad_cm", "boq", "anyloc")),
    *((n, (112, 112), "more than 64 patches") for n in ("salad", "salad_cm", "megaloc")),
    *((n, (224, 238), "exactly 224 × 224 pixels; found height 224") for n in ("cricavpr", "selavpr")),
    ("boq", (0, 14), "positive multiples of 14"),
    ("megaloc", (5, 3000), "more than 64 patches"),
    ("mixvpr", (322, 322), "exactly 320 × 320 pixels; found height 322"),
    ("selavprpp", (322, 308), "square images with a side that is a multiple of 14"),
    ("selavprpp", (320, 320), "Resize them, for example to 322 × 322"),
    ("cosplace", (31, 640), "at least 32 pixels on each side; found height 31"),
    ("eigenplaces", (640, 31), "at least 32 pixels on each side; found height 640, width 31"),
]


@pytest.mark.parametrize(("name", "size", "message"), BAD_SIZES)
def test_a_wrong_size_is_refused_with_the_rule(name, size, message):
    with torch.device("meta"):
        model, batch = METHODS[name].build(), torch.empty(1, 3, *size)
    with pytest.raises(ValueError, match=re.escape(message)):
        model(batch)
    for method in ("global_and_local", "descriptors_and_codes"):
        if hasattr(model, method):
            with pytest.raises(ValueError, match=re.escape(message)):
                getattr(model, method)(batch)


@pytest.mark.parametrize(
    ("batch", "message"),
    [
        (torch.zeros(3, 224, 224), r"shape \(b, 3, height, width\), b at least 1; found \(3, 224, 224\)"),
        (torch.zeros(1, 224, 224, 3), r"found \(1, 224, 224, 3\). Give RGB images, channels first"),
        (torch.zeros(0, 3, 224, 224), r"found \(0, 3, 224, 224\)"),
        (torch.zeros(1, 3, 224, 224, dtype=torch.uint8), r"found images of type torch.uint8"),
        (torch.zeros(1, 3, 224, 224, dtype=torch.float64), r"weights of type torch.float32 on cpu"),
        (np.zeros((1, 3, 224, 224), np.float32), r"takes a torch.Tensor of images; found ndarray"),
    ],
)
def test_images_that_are_no_batch_of_float32_rgb_are_refused(batch, message):
    with pytest.raises(ValueError, match=f"EigenPlaces .*{message}"):
        methods.build("eigenplaces")(batch)


def test_a_model_without_weights_says_so():
    with torch.device("meta"):
        model = methods.build("cosplace")
    with pytest.raises(ValueError, match="holds no weights"):
        model(torch.zeros(1, 3, 224, 224))


# --- other input sizes ---


def cubic(x: np.ndarray) -> np.ndarray:
    """Keys' cubic convolution kernel with a = −0.75."""
    x = np.abs(x)
    near = (1.25 * x - 2.25) * x**2 + 1
    far = -0.75 * (((x - 5) * x + 8) * x - 4)
    return np.where(x <= 1, near, np.where(x < 2, far, 0.0))


def resampling_matrix(length: int) -> np.ndarray:
    """Weights (length, 37) of bicubic interpolation with step 37 / (length + 0.1), edges repeated."""
    positions = (np.arange(length) + 0.5) * 37 / (length + 0.1) - 0.5
    matrix = np.zeros((length, 37))
    for row, position in enumerate(positions):
        for sample in range(math.floor(position) - 1, math.floor(position) + 3):
            matrix[row, min(max(sample, 0), 36)] += cubic(position - sample)
    return matrix


@REPEATABLE
@given(rows=st.integers(1, 60), columns=st.integers(1, 60), seed=st.integers(0, 2**32 - 1))
def test_position_embeddings_are_resampled_bicubically_with_the_offset(rows, columns, seed):
    embedding = np.random.default_rng(seed).standard_normal((1, 1 + 37 * 37, 3))
    grid = embedding[0, 1:].reshape(37, 37, 3)
    expected = np.einsum("ri,cj,ijk->rck", resampling_matrix(rows), resampling_matrix(columns), grid)
    if rows == columns == 37:  # DINOv2 leaves the trained grid as it is
        expected = grid
    found = interpolate_positions(torch.from_numpy(embedding), rows, columns).numpy()
    assert np.allclose(found[0, 1:].reshape(rows, columns, 3), expected, rtol=0, atol=1e-9)
    assert np.array_equal(found[:, 0], embedding[:, 0])


def transposed(run: Run) -> nn.Module:
    """Return the model that sees a transposed image as the run's model sees the image."""
    with torch.device("meta"):
        mirror = METHODS[run.name].build()
    state = dict(run.model.state_dict())
    for key, tensor in state.items():
        if tensor.ndim == 4:
            state[key] = tensor.transpose(2, 3).contiguous()
        elif key.endswith("pos_embed"):
            grid = tensor[:, 1:].unflatten(1, (37, 37)).transpose(1, 2).flatten(1, 2)
            state[key] = torch.cat((tensor[:, :1], grid), dim=1)
    mirror.load_state_dict(state, assign=True)
    return mirror


@runs_of("cosplace", "eigenplaces", "salad", "megaloc", "boq", "anyloc")
def test_height_and_width_are_interchangeable(run):
    batch = images(56, 98) if run.name == "anyloc" else images(126, 182)
    found = run.model(batch)
    assert_descriptors_equal(transposed(run)(batch.transpose(2, 3)), found)
    swapped = run.model(batch.transpose(2, 3))
    assert (swapped - found).norm(dim=1).min() > 1e-3  # the symmetry is not trivial


@runs_of("megaloc")
def test_megaloc_resizes_by_itself(run):
    batch = images(150, 201)
    assert_descriptors_equal(run.model(batch), run.model(resize_to_patches(batch)))
    assert resize_to_patches(batch[:, :, :140, :196]).shape == (2, 3, 140, 196)


def triangle_matrix(length: int, out: int) -> np.ndarray:
    """Weights (out, length) of bilinear interpolation with antialiasing."""
    scale = length / out
    centres = (np.arange(out)[:, None] + 0.5) * scale
    distance = np.abs(np.arange(length) + 0.5 - centres) / max(scale, 1)
    matrix = np.maximum(0, 1 - distance)
    return matrix / matrix.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("size", "expected"),
    [((300, 400), (294, 406)), ((133, 217), (140, 224)), ((119, 147), (112, 140)), ((322, 300), (322, 294))],
)
def test_resizing_to_whole_patches_is_bilinear_with_antialiasing(size, expected):
    batch = images(*size).double()
    rows, columns = (triangle_matrix(a, b) for a, b in zip(size, expected, strict=True))
    found = resize_to_patches(batch).numpy()
    assert np.allclose(found, rows @ batch.numpy() @ columns.T, rtol=0, atol=1e-6)


# --- the mathematics of the parts ---


def normal(seed: int, *shape: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(shape))


@REPEATABLE
@given(exponent=st.floats(0.5, 8), seed=st.integers(0, 99))
def test_gem_is_the_generalised_mean(exponent, seed):
    pool = GeM()
    pool.p.data = torch.tensor([exponent], dtype=torch.float64)
    features = normal(seed, 2, 3, 4, 5)
    expected = (np.maximum(features.numpy(), 1e-6) ** exponent).mean(axis=(2, 3)) ** (1 / exponent)
    assert np.allclose(pool(features).detach().numpy()[..., 0, 0], expected, rtol=1e-9)


def test_unit_gem_ignores_the_length_of_the_channel_vectors():
    features, lengths = normal(0, 2, 3, 4, 5), normal(1, 2, 1, 4, 5).exp()
    pool = unit_gem().double()
    torch.testing.assert_close(pool(features * lengths), pool(features))


def plan_by_scaling(scores: np.ndarray, iterations: int) -> np.ndarray:
    """Sinkhorn's algorithm as it is usually stated: scale the rows, then the columns, of exp(scores)."""
    clusters, patches = scores.shape
    kernel = np.exp(np.vstack([scores, np.zeros(patches)]))
    targets = np.append(np.ones(clusters), patches - clusters)
    rows, columns = np.ones(clusters + 1), np.ones(patches)
    for _ in range(iterations):
        rows = targets / (kernel @ columns)
        columns = 1 / (kernel.T @ rows)
    return rows[:, None] * kernel * columns


@REPEATABLE
@given(clusters=st.integers(1, 6), more=st.integers(1, 9), iterations=st.integers(1, 4), seed=st.integers(0, 99))
def test_transport_is_sinkhorn_scaling_with_a_dustbin(clusters, more, iterations, seed):
    scores = 2 * normal(seed, 2, clusters, clusters + more)
    found = assign_by_transport(scores, torch.tensor(0.7, dtype=torch.float64), iterations)
    expected = np.stack([plan_by_scaling(s, iterations)[:-1] for s in scores.numpy()])
    assert np.allclose(found.numpy(), expected, rtol=1e-9)
    assert (found.sum(dim=1) <= 1 + 1e-12).all()


def test_transport_converges_to_the_marginals():
    shares = assign_by_transport(normal(0, 1, 5, 20), torch.tensor(1.0, dtype=torch.float64), iterations=200)
    torch.testing.assert_close(shares.sum(dim=2), torch.ones(1, 5, dtype=torch.float64))
    assert shares.sum(dim=1).max() <= 1


def test_transport_ignores_a_constant_per_row_and_survives_large_scores():
    scores, dustbin = normal(0, 1, 5, 20), torch.tensor(1.0, dtype=torch.float64)
    expected = assign_by_transport(scores, dustbin)
    torch.testing.assert_close(assign_by_transport(scores + normal(1, 1, 5, 1), dustbin + 3), expected)
    assert assign_by_transport(1e4 * scores.float(), dustbin.float()).isfinite().all()


@REPEATABLE
@given(patches=st.integers(1, 12), clusters=st.integers(1, 6), seed=st.integers(0, 99))
def test_vlad_sums_residuals_from_the_centres(patches, clusters, seed):
    features = functional.normalize(normal(seed, 2, patches, 4), dim=2)
    centres = normal(seed + 100, clusters, 4)
    for image, found in zip(features, vlad(features, centres), strict=True):
        sums = torch.zeros(clusters, 4, dtype=torch.float64)
        for feature in image:
            nearest = max(range(clusters), key=lambda k: feature @ centres[k] / centres[k].norm())
            sums[nearest] += feature - centres[nearest]
        expected = torch.cat([row / row.norm() if row.any() else row for row in sums])
        torch.testing.assert_close(found, expected / expected.norm())


def mutual_by_loops(query: torch.Tensor, candidate: torch.Tensor) -> int:
    similarity = query @ candidate.T
    count = 0
    for i in range(len(query)):
        j = int(similarity[i].argmax())
        count += int(similarity[:, j].argmax()) == i
    return 0 if count == 1 else count


@REPEATABLE
@given(
    m=st.integers(1, 9),
    n=st.integers(1, 9),
    k=st.integers(0, 5),
    block=st.integers(1, 6),
    seed=st.integers(0, 99),
)
def test_match_count_counts_mutual_nearest_neighbours(m, n, k, block, seed):
    query, candidates = normal(seed, m, 3), normal(seed + 100, k, n, 3)
    found = match_count(query, candidates, block=block)
    assert found.dtype == torch.int64
    assert found.tolist() == [mutual_by_loops(query, candidate) for candidate in candidates]


def test_match_count_takes_maps_and_scores_a_single_match_as_none():
    features = functional.normalize(normal(0, 4, 5, 8), dim=2)
    assert match_count(features, features[None]).tolist() == [20]
    assert match_count(features[:1, :1], features[None]).tolist() == [0]
    with pytest.raises(ValueError, match=r"same c; found \(4, 5, 8\) and \(2, 5, 7\)"):
        match_count(features, torch.zeros(2, 5, 7))
    with pytest.raises(ValueError, match="at least 1 candidate; found 0"):
        match_count(features, features[None], block=0)


def test_encoder_layer_equals_pytorchs():
    for activation in ("relu", "gelu"):
        reference = nn.TransformerEncoderLayer(24, 3, 40, dropout=0.0, activation=activation, batch_first=True)
        layer = EncoderLayer(24, 3, 40, getattr(functional, activation))
        state = {key: normal(i, *v.shape).float() / 3 for i, (key, v) in enumerate(reference.state_dict().items())}
        reference.load_state_dict(state)
        layer.load_state_dict(state)
        x = normal(99, 2, 7, 24).float()
        torch.testing.assert_close(layer(x), reference.eval()(x), rtol=1e-4, atol=1e-5)


def test_attention_to_a_context_equals_pytorchs():
    reference, attention = nn.MultiheadAttention(24, 3, batch_first=True), MultiHeadAttention(24, 3)
    attention.load_state_dict(reference.state_dict())
    queries, context = normal(0, 2, 5, 24).float(), normal(1, 2, 9, 24).float()
    torch.testing.assert_close(attention(queries, context), reference(queries, context, context)[0])


def test_self_attention_is_softmax_attention_per_head():
    attention = SelfAttention(12, 3).double()
    x = normal(0, 2, 7, 12)
    q, k, v = attention.qkv(x).chunk(3, dim=2)
    heads = []
    for part in range(3):
        columns = slice(4 * part, 4 * part + 4)
        scores = q[..., columns] @ k[..., columns].transpose(1, 2) / math.sqrt(4)
        heads.append(scores.softmax(dim=2) @ v[..., columns])
    torch.testing.assert_close(attention(x), attention.proj(torch.cat(heads, dim=2)))


def test_gated_perceptron_multiplies_by_the_activated_first_half():
    gated = GatedPerceptron(12).double()
    x = normal(0, 2, 7, 12)
    gate, value = gated.w12(x)[..., :32], gated.w12(x)[..., 32:]
    torch.testing.assert_close(gated(x), gated.w3(gate * gate.sigmoid() * value))


def test_multi_scale_adapter_follows_the_grid_and_doubles_the_token():
    adapter = MultiScaleAdapter(64).double().eval()
    x = normal(0, 2, 1 + 3 * 5, 64)
    found = adapter(x, (3, 5))
    hidden = adapter.D_fc1(x).relu()
    torch.testing.assert_close(found[:, 0], adapter.D_fc2(2 * hidden[:, 0]))
    for branch in (adapter.branch1.conv, adapter.branch2[1].conv, adapter.branch3[1].conv):
        branch.weight.data = branch.weight.transpose(2, 3).contiguous()
    mirrored = torch.cat((x[:, :1], x[:, 1:].unflatten(1, (3, 5)).transpose(1, 2).flatten(1, 2)), dim=1)
    again = adapter(mirrored, (5, 3))[:, 1:].unflatten(1, (5, 3)).transpose(1, 2).flatten(1, 2)
    torch.testing.assert_close(again, found[:, 1:])


# --- the record that the book shows ---


def test_the_recorded_parity_covers_every_method_and_holds_its_limits():
    from artifact.methods.parity import recorded

    table = recorded()
    assert set(table["method"]) == set(METHODS)
    assert (table["max_abs"] <= table["limit_abs"]).all()
    assert (table["max_l2"] <= table["limit_l2"].fillna(np.inf)).all()
    described = table[table["output"].str.startswith("descriptors")]
    assert set(described["method"]) == set(METHODS)
    assert (described["limit_abs"] == 1e-6).all()
