"""The embedded descriptors against their definitions."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import REPOSITORY, tiny_manifest, write_manifest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from artifact import datasets, manifest, methods, store
from artifact.datasets.images import UnreadableImageError, read_image
from artifact.extraction import extract, jobs
from artifact.manifest.entries import ManifestError, Preprocessing
from artifact.methods import efficientnet_lite
from artifact.methods.hog import HOG
from artifact.methods.preprocessing import prepare, target_size
from artifact.methods.thumbnail import Thumbnail


def grey(seed, height=32, width=48, batch=2):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0, 1, (batch, 1, height, width)).astype(np.float32))


def test_thumbnail_normalises_every_patch():
    images = grey(0, 16, 24)
    expected = []
    for image in images.numpy()[:, 0]:
        patches = [image[y : y + 8, x : x + 8] for y in (0, 8) for x in (0, 8, 16)]
        expected.append(np.sort(np.concatenate([((p - p.mean()) / p.std()).ravel() for p in patches])))
    out = np.sort(Thumbnail()(images).numpy(), axis=1)
    expected = np.array(expected)
    np.testing.assert_allclose(out, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.2, 3), st.floats(-1, 1), st.integers(0, 100))
def test_thumbnail_ignores_local_brightness_and_contrast(contrast, brightness, seed):
    images = grey(seed)
    np.testing.assert_allclose(Thumbnail()(images * contrast + brightness), Thumbnail()(images), atol=2e-4)


def test_thumbnail_of_a_flat_patch_is_zero_there():
    images = grey(1, 8, 16)
    images[:, :, :, :8] = 0.5
    np.testing.assert_allclose(np.linalg.norm(Thumbnail()(images)), math.sqrt(2), atol=1e-5)
    assert (Thumbnail()(images) == 0).sum() == 2 * 64
    with pytest.raises(ValueError, match="multiples of 8"):
        Thumbnail()(grey(0, 12, 16))


def loop_hog(image, cell=16, orientations=9):
    """Histograms of oriented gradients by explicit loops over pixels."""
    height, width = image.shape
    padded = np.pad(image.astype(np.float64), 1, mode="edge")
    cells = np.zeros((height // cell, width // cell, orientations))
    for y in range(height):
        for x in range(width):
            dx, dy = padded[y + 1, x + 2] - padded[y + 1, x], padded[y + 2, x + 1] - padded[y, x + 1]
            place = (math.atan2(dy, dx) % math.pi) / math.pi * orientations
            low, share = int(place), place - int(place)
            cells[y // cell, x // cell, low % orientations] += math.hypot(dx, dy) * (1 - share)
            cells[y // cell, x // cell, (low + 1) % orientations] += math.hypot(dx, dy) * share
    blocks = np.zeros((4 * orientations, height // cell - 1, width // cell - 1))
    for y in range(height // cell - 1):
        for x in range(width // cell - 1):
            block = np.concatenate([cells[y, x], cells[y, x + 1], cells[y + 1, x], cells[y + 1, x + 1]])
            block = np.minimum(block / np.linalg.norm(block), 0.2)
            blocks[:, y, x] = block / np.linalg.norm(block)
    return blocks.ravel() / np.linalg.norm(blocks)


def test_hog_equals_a_loop_over_pixels():
    images = grey(3)
    expected = np.array([loop_hog(image) for image in images.numpy()[:, 0]])
    np.testing.assert_allclose(HOG()(images).numpy(), expected, atol=1e-5)


def test_hog_does_not_see_brightness_contrast_or_negatives():
    images = grey(4)
    for changed in (images * 0.3 + 0.5, 1 - images):
        np.testing.assert_allclose(HOG()(changed), HOG()(images), atol=1e-4)
    with pytest.raises(ValueError, match="multiples of 16, at least 32"):
        HOG()(grey(0, 16, 64))


def test_efficientnet_loads_every_weight_of_the_shipped_checkpoint_and_describes_any_size():
    model = efficientnet_lite.efficientnet_lite0()
    state = torch.load(efficientnet_lite.weights_path(), map_location="cpu", weights_only=True)
    unfolded = efficientnet_lite.EfficientNetLite0()
    assert set(unfolded.state_dict()) == {name for name in state if not name.startswith("_fc.")}
    assert not [part for part in model.modules() if isinstance(part, torch.nn.BatchNorm2d)]
    with torch.inference_mode():
        for size in ((64, 96), (75, 131)):
            out = model(torch.zeros(2, 3, *size))
            assert out.shape == (2, 1280)
            np.testing.assert_allclose(out.norm(dim=1), 1, atol=1e-5)


def test_efficientnet_classifies_as_its_classifier_was_trained():
    """The trunk is right only if the released classifier is sure about a drawn object: a synthetic traffic light."""
    model = efficientnet_lite.efficientnet_lite0()
    picture = Image.new("RGB", (224, 224), (120, 170, 220))
    pixels = np.asarray(picture).copy()
    pixels[20:200, 85:140] = 15
    y, x = np.mgrid[:224, :224]
    for centre, colour in ((50, (255, 30, 20)), (110, (90, 70, 10)), (170, (10, 70, 30))):
        pixels[(y - centre) ** 2 + (x - 112) ** 2 < 22**2] = colour
    image = (torch.from_numpy(pixels).permute(2, 0, 1)[None].float() - 127) / 128
    features = []
    handle = model._bn1.register_forward_hook(lambda module, inputs, output: features.append(output))
    with torch.inference_mode():
        model(image)
    handle.remove()
    state = torch.load(efficientnet_lite.weights_path(), map_location="cpu", weights_only=True)
    scores = features[0].clamp(0, 6).mean(dim=(2, 3)) @ state["_fc.weight"].T + state["_fc.bias"]
    assert int(scores.argmax()) == 920  # ImageNet class 920: traffic light


@pytest.mark.parametrize("exponent", [1.0, 3.0, 4.0])
def test_efficientnet_pools_by_the_generalised_mean(exponent):
    model = efficientnet_lite.EfficientNetLite0(exponent).eval()
    maps = []
    model._bn1.register_forward_hook(lambda module, inputs, output: maps.append(output.clamp(0, 6)))
    with torch.inference_mode():
        out = model(torch.rand(2, 3, 64, 96))
    values = maps[0].clamp(min=1e-6).double().flatten(2)
    pooled = (values**exponent).mean(dim=2) ** (1 / exponent)
    np.testing.assert_allclose(out, pooled / pooled.norm(dim=1, keepdim=True), atol=1e-5)


def test_folding_normalisations_leaves_the_function_as_it_is():
    torch.manual_seed(0)
    model = efficientnet_lite.EfficientNetLite0()
    for part in model.modules():
        if isinstance(part, torch.nn.BatchNorm2d):
            part.running_mean.normal_(0, 0.2)
            part.running_var.uniform_(0.5, 2)
            part.weight.data.uniform_(0.5, 2)
            part.bias.data.normal_()
    images = torch.rand(2, 3, 64, 96)
    with torch.inference_mode():
        expected = model.eval().maps(images)
        found = efficientnet_lite.folded(model).maps(images)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-4, rtol=2e-4)


def middle_map(seed, height=12, width=16):
    maps = torch.from_numpy(np.random.default_rng(seed).normal(size=(2, 112, height, width)).astype(np.float32))
    return efficientnet_lite.Maps(maps, maps)


def test_vlad_sums_residuals_to_the_nearest_word():
    words = np.random.default_rng(1).normal(size=(5, 112)).astype(np.float32)
    words /= 2 * np.linalg.norm(words, axis=1, keepdims=True)
    maps = middle_map(2)
    found = efficientnet_lite.EfficientNetLite0VLAD(torch.from_numpy(words)).head(maps).numpy()
    for image, descriptor in zip(maps.middle.numpy(), found, strict=True):
        expected = np.zeros((5, 112))
        for feature in image.reshape(112, -1).T:
            feature = feature / np.linalg.norm(feature)
            expected[np.argmax(words @ feature)] += feature - words[np.argmax(words @ feature)]
        expected /= np.maximum(np.linalg.norm(expected, axis=1, keepdims=True), 1e-12)
        np.testing.assert_allclose(descriptor, expected.ravel() / np.linalg.norm(expected), atol=1e-5)


def test_the_grid_keeps_means_of_four_by_four_cells():
    maps = middle_map(3)
    found = efficientnet_lite.EfficientNetLite0Grid().head(maps).numpy()
    cells = maps.middle.numpy().reshape(2, 112, 4, 3, 4, 4).mean(axis=(3, 5)).reshape(2, 112, 16).transpose(0, 2, 1)
    cells /= np.linalg.norm(cells, axis=2, keepdims=True)
    np.testing.assert_allclose(found, cells.reshape(2, -1) / 4, atol=1e-5)


def test_the_vocabulary_ships_with_its_record():
    path = Path(methods.__file__).parent / efficientnet_lite.VOCABULARY
    words, record = np.load(path), store.read_json(path.with_suffix(".json"))
    assert (words.shape, words.dtype) == ((16, 112), np.float32)
    assert record["sha256"] == store.digest_of_file(path)
    assert len(record["images"]) == 2


def test_methods_of_a_trunk_are_described_by_one_pass_as_each_alone():
    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    entries = methods.of_trunk(loaded, "efficientnet_lite0_vlad")
    assert list(entries) == ["efficientnet_lite0", "efficientnet_lite0_vlad", "efficientnet_lite0_grid"]
    assert list(methods.of_trunk(loaded, "hog")) == ["hog"]
    images = torch.rand(2, 3, 64, 96)
    with torch.inference_mode():
        for (name, entry), found in zip(
            entries.items(), methods.shared(entries, torch.device("cpu"))(images), strict=True
        ):
            assert found.shape == (2, entry.dimension)
            np.testing.assert_allclose(found, methods.build(name)(images), atol=1e-6)
            np.testing.assert_allclose(found.norm(dim=1), 1, atol=1e-5)


def test_building_by_name():
    assert {"thumbnail", "hog", "efficientnet_lite0", "salad"} <= set(methods.names())
    assert not methods.build("hog").training
    with pytest.raises(KeyError, match="no method 'vlad'; the methods are thumbnail, hog"):
        methods.build("vlad")


# -- preprocessing --------------------------------------------------------------------------------------------------


def picture(height, width):
    return Image.fromarray(np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8))


def test_fixed_size_is_pillows_resize_then_normalisation():
    image = picture(50, 70)
    rule = Preprocessing(resize="fixed", size=[20, 30], mean=[0.1, 0.2, 0.3], std=[0.5, 0.4, 0.3])
    expected = np.asarray(image.resize((30, 20), Image.Resampling.BILINEAR)) / 255
    expected = (expected - [0.1, 0.2, 0.3]) / [0.5, 0.4, 0.3]
    np.testing.assert_allclose(prepare(image, rule).numpy(), expected.transpose(2, 0, 1), atol=1e-6)


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_tensor_resize_with_antialias_is_close_to_pillows(interpolation):
    """Pillow rounds to 8 bits after each axis, so the two differ by about a grey level, not more."""
    image = picture(120, 160)
    rules = [
        Preprocessing(
            resize="fixed", size=[30, 44], library=library, interpolation=interpolation, mean=[0.0] * 3, std=[1.0] * 3
        )
        for library in ("pillow", "tensor")
    ]
    difference = (prepare(image, rules[0]) - prepare(image, rules[1])).abs()
    assert difference.max() < 1.6 / 255
    rough = rules[1].model_copy(update={"antialias": False})
    assert (prepare(image, rules[1]) - prepare(image, rough)).abs().max() > 0.1


def test_native_size_is_kept_or_bounded_and_cropped():
    image = picture(100, 150)
    assert prepare(image, Preprocessing(resize="native")).shape == (3, 100, 150)
    rule = Preprocessing(resize="native", longest_side=75, library="tensor", crop_to_multiple_of=14)
    assert target_size(100, 150, rule) == (50, 75)
    cropped = prepare(image, rule)
    assert cropped.shape == (3, 42, 70)
    whole = prepare(image, rule.model_copy(update={"crop_to_multiple_of": 1}))
    np.testing.assert_array_equal(cropped, whole[:, 4:46, 2:72])


def test_grey_is_luma(tmp_path):
    image = picture(16, 16)
    rule = Preprocessing(resize="native", colour="grey", mean=[0.0], std=[1.0])
    image.save(tmp_path / "colour.png")
    expected = np.asarray(image) @ [0.299, 0.587, 0.114] / 255
    np.testing.assert_allclose(prepare(read_image(tmp_path / "colour.png", "grey"), rule)[0], expected, atol=1 / 255)


def test_unreadable_images_are_named(tmp_path):
    path = tmp_path / "a.png"
    for content in (None, b"", b"x" * 100):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(UnreadableImageError, match="a.png"):
            read_image(path)


def test_images_go_through_a_trunk_once_for_all_its_methods(project, monkeypatch):
    shipped = manifest.load(REPOSITORY / "data_manifest.yaml")
    content = tiny_manifest()
    for name in methods.of_trunk(shipped, "efficientnet_lite0"):
        entry = shipped.method(name).model_dump(exclude_none=True)
        entry["preprocessing"] |= {"size": [64, 96]}
        content["methods"][name] = entry | {"batch_size": 4}
    loaded = manifest.load(write_manifest(project, content))
    traversal = datasets.load_traversal(loaded, "street", "day")
    described, original = [], efficientnet_lite.EfficientNetLite0.maps

    def counting(self, images):
        described.append(len(images))
        return original(self, images)

    monkeypatch.setattr(efficientnet_lite.EfficientNetLite0, "maps", counting)
    assert [job.method for job in jobs.jobs_of(loaded, traversal, "efficientnet_lite0_grid")] == ["efficientnet_lite0"]
    found = {
        name: extract.descriptors(loaded, traversal, name, workers=0)
        for name in ("efficientnet_lite0_grid", "efficientnet_lite0", "efficientnet_lite0_vlad")
    }
    assert described == [4, 4, 4]
    for name, one in found.items():
        images = [prepare(read_image(path), loaded.method(name).preprocessing) for path in traversal.image_paths()]
        with torch.inference_mode():
            np.testing.assert_allclose(one.values, methods.build(name)(torch.stack(images)), atol=1e-5)
        assert one.sidecar["method"] == name


def test_methods_of_a_trunk_must_see_the_same_images(project):
    content = tiny_manifest()
    content["methods"]["hog"] |= {"trunk": "shared"}
    content["methods"]["thumbnail"] |= {"trunk": "shared"}
    with pytest.raises(ManifestError, match="the same trunk: their preprocessing must be equal"):
        manifest.load(write_manifest(project, content))
