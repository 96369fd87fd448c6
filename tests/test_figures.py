"""Figures where they are easily wrong: the paper's curves under ours, frames on maps, few images, match counts."""

import numpy as np
import pandas as pd
import pytest
from conftest import tiny_manifest, write_images, write_manifest

from artifact import manifest, pages, studies
from artifact.manifest.entries import ManifestError
from artifact.pages import distractors, galleries
from artifact.pages.scope import NothingToShowError
from artifact.pages.style import in_the_plane
from artifact.studies import reported

TITLES = {"anyloc": "AnyLoc", "salad": "SALAD"}


@pytest.fixture
def drawn(monkeypatch):
    """What a page draws, as the figure itself."""
    for module in (pages.distractors, pages.mixed_database):
        monkeypatch.setattr(module, "embed", lambda figure, text, **_: figure)


def dashed(axes):
    return [line for line in axes.lines if line.get_linestyle() == "--" and len(line.get_xdata()) > 2]


def curves(x, values):
    return pd.DataFrame([{"method": m, x: at, "DAR": 50.0 + i} for m in TITLES for i, at in enumerate(values)])


@pytest.mark.usefixtures("drawn")
def test_the_papers_curves_lie_under_the_measured_ones():
    tables = [
        reported.table(name).rename(columns=distractors._RENAMED).query("method in @TITLES")
        for name in ("fig06_number", "fig06_distance", "fig07")
    ]
    number, distance, condition = (table.assign(reported=table["DAR"], DAR=table["DAR"] + 3) for table in tables)
    figure = distractors.number_and_distance(number, distance, TITLES)
    for axes, table in zip(figure.axes, (number, distance), strict=True):
        found = [line.get_ydata().tolist() for line in dashed(axes)]
        assert found == [rows["reported"].tolist() for _, rows in table.groupby("method", sort=False)]
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == "the paper"
    figure = distractors.condition(
        condition.assign(traversal=condition["condition"]), TITLES, query_condition="sun,clouds"
    )
    assert len(dashed(figure.axes[0])) == 2


@pytest.mark.usefixtures("drawn")
def test_without_reported_values_there_is_no_dashed_line():
    number = curves("ratio", [0, 0.5, 1]).assign(reported=np.nan)
    figure = distractors.number_and_distance(number, curves("distance", [25, 50, np.inf]), TITLES)
    assert not any(dashed(axes) for axes in figure.axes)
    assert len(figure.legends[0].get_texts()) == len(TITLES)


@pytest.mark.usefixtures("drawn")
def test_two_traversals_of_one_condition_are_told_apart():
    rows = [("q", "sun", 40), ("sun_2", "sun", 50), ("wet", "rain", 70), ("none", "none", 90)]
    table = pd.DataFrame([{"method": m, "traversal": t, "condition": c, "DAR": d} for m in TITLES for t, c, d in rows])
    figure = distractors.condition(table, TITLES, query_condition="sun")
    labels = [label.get_text() for label in figure.axes[0].get_xticklabels()]
    assert labels == ["sun\nq\n(query)", "sun\nsun_2", "rain", "none"]
    assert figure.axes[0].lines[0].get_ydata().tolist() == [40, 50, 70, 90]


def test_a_page_says_what_is_a_mean_of_draws_and_of_how_many():
    number = pd.DataFrame({"method": ["anyloc", "salad"], "draws": [0, 7]})
    text = distractors.about_draws(number, TITLES)
    assert "the line of AnyLoc is the exact expectation" in text
    assert "that of SALAD is the mean of 7 nested random draws" in text
    assert "exact" not in distractors.about_draws(number[1:], TITLES)


def frames(tmp_path, n, unit="frames"):
    """A dataset of frames or pairs with a traversal of the query's kind of condition."""
    parts = {"day": 0, "night": -60, "day_2": 5}
    for name, brightness in parts.items():
        write_images(tmp_path / "data" / "street" / name, n, seed=6, brightness=brightness, noise=25)
    street = {
        "title": "Street",
        "kind": "folder",
        "threshold": {"value": float(unit == "frames"), "unit": unit},
        "query": "day",
        "database": "night",
        "same_condition_traversal": "day_2",
        "traversals": {name: {"condition": name} for name in parts},
    }
    return manifest.load(write_manifest(tmp_path, tiny_manifest(street=street)))


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("unit", ["frames", "pairs"])
def test_maps_of_frames_and_pairs_lie_on_a_line(tmp_path, unit):
    loaded = frames(tmp_path, 40, unit)
    titles, conditions = {"hog": "HOG"}, ("day", "night", "day_2")
    mixed = studies.mixed_database.mixed_database(loaded, "street", "hog")
    figure = pages.mixed_database.mixed_database(
        {"hog": mixed}, {"single": "before", "mixed": "after"}, conditions, titles
    )
    points = np.concatenate(
        [c.get_offsets() for axes in figure.axes for c in axes.collections if len(c.get_offsets()) > 1]
    )
    assert len(points) >= 160
    assert (points[:, 1] == 0).all()
    after = studies.mixed_database.mixed_database_suppressed(loaded, "street", "hog", iterations=2)
    pages.mixed_database.mixed_database({"hog": after}, {"original": "a", "INLP": "b"}, conditions, titles)


def test_a_map_of_two_or_three_images_says_why_there_is_none(tmp_path):
    for n in (2, 3):
        loaded = frames(tmp_path / str(n), n)
        with pytest.raises(NothingToShowError, match="Street has too few images for a map: 1 queries"):
            studies.embedding.embedding(loaded, "street", "hog")


def test_two_stage_methods_are_not_suppressed(tmp_path):
    loaded = frames(tmp_path, 12)
    entry = loaded.methods["hog"].model_copy(update={"rerank": 10, "code_bits": 8})
    loaded.methods["two"] = entry
    for study in (
        studies.embedding.embedding,
        studies.erased.what_is_erased,
        studies.mixed_database.mixed_database,
        studies.mixed_database.mixed_database_suppressed,
    ):
        with pytest.raises(ManifestError, match="'two' re-ranks"):
            study(loaded, "street", "two")


def test_scores_are_in_their_own_unit():
    measured = studies.evaluated.Measured(None, None, (), "matches")
    assert galleries._score(measured, 412.0) == "412 matches"
    assert galleries._score(studies.evaluated.Measured(None, None, ()), 0.5) == "cosine 0.500"


def test_maps_are_seen_from_above():
    from artifact.datasets.positions import earth_centred

    latitude, longitude = 48.0 + np.array([0, 0, 1e-3]), 11.0 + np.array([0, 1e-3, 0])
    positions = earth_centred(latitude, longitude)
    found = in_the_plane(positions, positions[0])
    np.testing.assert_allclose(found, [[0, 0], [74.6, 0], [0, 111.2]], atol=0.6)
    np.testing.assert_array_equal(in_the_plane(np.array([[1.0, 2.0, 9.0]]), np.zeros(3)), [[1, 2]])
