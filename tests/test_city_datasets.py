"""The six rendered pairs of the manifest: every query has a partner, and partners show the same place."""

from pathlib import Path

import numpy as np
import pytest

import artifact_city
from artifact import manifest
from artifact_city import rendering, traversal
from artifact_city.trace import BUILDING, LEAF

REPOSITORY = Path(__file__).resolve().parents[1]


ENTRIES = {n: e for n, e in manifest.load(REPOSITORY / "data_manifest.yaml").datasets.items() if e.kind == "city"}


def test_the_pairs_mirror_the_six_datasets_of_the_paper():
    assert {e.mirrors: (e.threshold.value, e.threshold.unit) for e in ENTRIES.values()} == {
        "AmsterTime": (0, "pairs"),
        "Gardens Point": (2, "frames"),
        "Nordland": (1, "frames"),
        "RobotCar": (25, "metres"),
        "St Lucia": (25, "metres"),
        "SVOX": (25, "metres"),
    }


@pytest.fixture(scope="module", params=ENTRIES)
def pair(request):
    """Query and database traversal of one dataset, with its entry; pytest runs all tests of one pair together."""
    entry = ENTRIES[request.param]
    made = {key: artifact_city.CityTraversal(**t.render) for key, t in entry.traversals.items()}
    return entry, made, made[entry.query], made[entry.database]


def test_every_query_has_a_positive_and_distractor_traversals_suffice(pair):
    entry, made, queries, database = pair
    distance = np.linalg.norm(
        artifact_city.positions(queries)[:, None] - artifact_city.positions(database)[None], axis=2
    )
    assert (distance.min(axis=1) <= entry.threshold.value).all()
    for name in entry.distractor_traversals:  # each of them passes every query's place
        along = artifact_city.positions(made[name])
        away = np.linalg.norm(artifact_city.positions(queries)[:, None] - along[None], axis=2).min(axis=1)
        assert away.max() < 2 * made[name].spacing
    assert len({t.seed for t in made.values()}) == len(made)


def visible_buildings(drive, index):
    """Numbers of the buildings in the middle half of a frame; a number names the same lot in every era."""
    surface = rendering.trace_frame(drive, index).surface
    codes = surface[surface.shape[0] // 4 : -surface.shape[0] // 4]
    return set(((codes[(codes >= BUILDING) & (codes < LEAF)] - BUILDING) >> 4).tolist())


def best_view(distance, turn, threshold):
    """Which frame within the threshold looks most nearly the same way from most nearly the same place."""
    within = np.flatnonzero(distance <= threshold)
    return within[np.argmin(distance[within] / 100 + turn[within])]


def shared(a, b):
    return len(a & b) / max(1, min(len(a), len(b)))


def test_both_traversals_of_a_pair_see_the_same_buildings(pair):
    entry, _, queries, database = pair
    heading = [np.array([p.heading for p in traversal.poses(t)[0]]) for t in (queries, database)]
    where = artifact_city.positions(queries), artifact_city.positions(database)
    near, far = [], []
    for i in np.linspace(0, queries.frames - 1, 5).astype(int):
        distance = np.linalg.norm(where[1] - where[0][i], axis=1)
        turn = np.abs(np.angle(np.exp(1j * (heading[1] - heading[0][i]))))
        j = best_view(distance, turn, entry.threshold.value)
        assert turn[j] < np.radians(25)
        shots = (queries, i), (database, j), (database, int(np.argmax(distance)))
        seen = [visible_buildings(*shot) for shot in shots]
        if len(seen[0]) > 2:  # along the railway there are places without buildings
            near.append(shared(seen[0], seen[1]))
            far.append(shared(seen[0], seen[2]))
    assert len(near) > 2
    assert min(near) > 0.5
    assert np.mean(near) > 0.8
    assert np.mean(far) < 0.3


def test_no_camera_stands_in_a_building(pair):
    for made in pair[1].values():
        buildings = rendering.town_of(made).scene.buildings
        at = np.array([(p.x, p.y) for p in traversal.poses(made)[0]])
        for some in np.array_split(at, 8):
            # Metres to the nearest wall; a lower bound near corners.
            wall = np.einsum("bkc,nc->nbk", buildings["normal"], some) - buildings["offset"]
            assert wall.max(axis=2).min() > 0.3
