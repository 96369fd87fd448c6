"""All eleven methods from image files to DAR, as the manifest prepares images for them, with untrained weights.

Untrained descriptors say nothing about places; what is tested is the way from files through preprocessing, batches, storage
and both stages of retrieval. Released weights take the same way (``tests/test_weights.py`` loads them).
"""

import functools

import numpy as np
import pytest
from conftest import real_data_root, write_manifest
from PIL import Image

import artifact_city
from artifact import datasets, methods
from artifact import manifest as manifests
from artifact.extraction import extract
from artifact.studies import evaluated

HERE = manifests.load()
METHODS = [name for name, entry in HERE.methods.items() if entry.kind == "paper"]
HEAVY = ("selavpr", "selavprpp", "anyloc")


def __getattr__(name):
    """A builder of each method, without weights, for the manifest."""
    if name not in METHODS:
        raise AttributeError(name)
    return functools.partial(methods.build, name)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Two places of the city by day and by night, and one of Gardens Point where its images are at hand."""
    folder = tmp_path_factory.mktemp("places") / "data" / "places"
    shown = HERE.datasets["city_day_night"].traversals
    root = real_data_root()
    for part, traversal, real in (("day", "sun", "day_right"), ("night", "night", "night_right")):
        (folder / part).mkdir(parents=True)
        drive = artifact_city.CityTraversal(**shown[traversal].render)
        for place in (20, 160):
            Image.fromarray(artifact_city.render_frame(drive, place)).save(folder / part / f"{place}.png")
        if root is not None:
            picture = Image.open(sorted((root / "gardens_point" / real).glob("*.jpg"))[80])
            picture.thumbnail((320, 320))
            picture.save(folder / part / "300.png")
    return folder


def project_of(images, name):
    """A manifest with the repository's own entry of one method, but for its weights."""
    entry = HERE.methods[name].model_dump(exclude_unset=True, exclude={"weights"})
    entry["builder"] = f"{__name__}:{name}"
    content = {
        "version": 1,
        "data_root": "data",
        "methods": {name: entry},
        "datasets": {
            "places": {
                "title": "Places",
                "kind": "folder",
                "threshold": {"value": 0, "unit": "pairs"},
                "query": "day",
                "database": "night",
                "traversals": {part: {"condition": part} for part in ("day", "night")},
            }
        },
        "profiles": {"demo": {"description": "one method", "datasets": ["places"], "methods": [name]}},
    }
    return manifests.load(write_manifest(images.parents[1], content))


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in HEAVY else n for n in METHODS])
def test_from_image_files_to_dar(images, name, monkeypatch):
    given = project_of(images, name)
    built = methods.model_of(name, given.method(name))  # once: drawing the weights takes longer than using them
    monkeypatch.setattr(methods, "model_of", lambda *_: built)
    n = len(list((images / "day").iterdir()))
    described = extract.descriptors(given, datasets.load_traversal(given, "places", "day"), name, workers=0)
    assert described.values.shape == (n, HERE.methods[name].dimension)
    np.testing.assert_allclose(np.linalg.norm(described.values, axis=1), 1, atol=1e-5)
    assert np.ptp(described.values, axis=0).max() > 0
    result = evaluated.evaluation(given, "places", name).evaluation
    assert result.n_queries == n
    for k in range(1, 2 * n):
        assert 0 <= result.dar(k) <= 1
    # All n database images and n - 1 distractors: the positive is among them.
    assert result.recall(n) == result.dar(2 * n - 1) == 1
    assert (type(result).__name__ == "TwoStageEvaluation") == (name in ("selavpr", "selavprpp"))
