"""Image statistics: what each measures, that they are stored and shipped, and where they come from."""

import numpy as np
import pytest
from conftest import real_data_root
from PIL import Image

from artifact import datasets, manifest
from artifact.datasets import DatasetError
from artifact.datasets.appearance import STATISTICS, appearance, appearance_key, measure


def save(path, pixels):
    Image.fromarray(pixels.astype(np.uint8)).save(path)
    return dict(zip(STATISTICS, measure(path), strict=True))


def test_each_statistic_measures_its_own(tmp_path):
    rng = np.random.default_rng(0)
    grey = np.repeat(rng.uniform(60, 160, (48, 64, 1)), 3, axis=2)
    base = save(tmp_path / "base.png", grey)
    brighter = save(tmp_path / "brighter.png", grey + 60)
    assert brighter["brightness"] == pytest.approx(base["brightness"] + 60 / 255, abs=0.003)
    assert brighter["contrast"] == pytest.approx(base["contrast"], abs=0.003)
    stretched = save(tmp_path / "stretched.png", 110 + (grey - 110) * 1.5)
    assert stretched["contrast"] == pytest.approx(1.5 * base["contrast"], abs=0.01)
    assert base["saturation"] == 0
    coloured = grey.copy()
    coloured[..., 2] *= 0.4
    assert save(tmp_path / "coloured.png", coloured)["saturation"] == pytest.approx(0.6, abs=0.02)
    smooth = np.repeat(np.kron(rng.uniform(60, 160, (6, 8)), np.ones((8, 8)))[..., None], 3, axis=2)
    assert save(tmp_path / "smooth.png", smooth)["sharpness"] < 0.4 * base["sharpness"]


def test_sizes_do_not_matter(tmp_path):
    small = np.kron(np.random.default_rng(1).uniform(0, 255, (24, 32, 3)), np.ones((10, 10, 1)))
    one = save(tmp_path / "one.png", small)
    two = save(tmp_path / "two.png", np.kron(small, np.ones((2, 2, 1))))
    for name in ("brightness", "contrast", "saturation"):
        assert one[name] == pytest.approx(two[name], abs=0.02)


def test_statistics_are_stored_under_the_images(project, monkeypatch):
    street = datasets.load(manifest.load(project / "data_manifest.yaml"), "street")
    first = appearance(street.query, project / ".cache")
    assert first.shape == (12, len(STATISTICS))
    monkeypatch.setattr("artifact.datasets.appearance.measure", None)
    np.testing.assert_array_equal(appearance(street.query, project / ".cache"), first)
    assert appearance_key(street.query) != appearance_key(street.database)
    assert appearance(street.query, project / ".cache")[:, 0].mean() == pytest.approx(0.5, abs=0.1)


@pytest.mark.data
def test_the_shipped_statistics_are_those_of_the_images(tmp_path, monkeypatch):
    here = manifest.load()
    with_images = datasets.load(here, "gardens_point")
    measured = appearance(with_images.query, tmp_path)
    monkeypatch.setenv("ARTIFACT_DATA_ROOT", str(tmp_path))
    assert real_data_root() is None
    without = datasets.load(manifest.load(), "gardens_point")
    assert not without.query.has_images
    np.testing.assert_allclose(appearance(without.query, tmp_path / "other"), measured, atol=1e-6)


def test_without_images_and_shipped_statistics_the_message_says_how_to_obtain_them(tmp_path, monkeypatch):
    monkeypatch.setattr("artifact.datasets.shipped.appearance", lambda _: None)
    monkeypatch.setenv("ARTIFACT_DATA_ROOT", str(tmp_path))
    without = datasets.load(manifest.load(), "gardens_point")
    with pytest.raises(DatasetError, match="gardens_point"):
        appearance(without.query, tmp_path)
