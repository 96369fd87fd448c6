"""Claims are decided by intervals: they agree or differ beyond chance, and else cannot be told."""

import base64
import csv
import dataclasses
import io
import itertools
import json
import re
from importlib.resources import files

import numpy as np
import pandas as pd
import pytest
import synthetic
from PIL import Image

from artifact import evaluate, pages, studies
from artifact.book import build
from artifact.metrics.statistics import replicates
from artifact.studies.common import Study
from artifact.studies.judging import above, all_above, changes_places, first_of, more_often, mostly, some_above, within

TITLES = {name: name.upper() for name in "abcd"}


def around(values, spread, count=1000, seed=0):
    """Replicates of values with a spread."""
    values = np.asarray(values, float)
    return values[..., None] + spread * np.random.default_rng(seed).normal(size=(*values.shape, count))


@pytest.mark.parametrize(("value", "spread", "verdict"), [(5, 1, "agrees"), (-5, 1, "differs"), (1, 2, "cannot tell")])
def test_a_number_is_above_a_bound_where_its_interval_is(value, spread, verdict):
    judged = above(value, around(value, spread), 0)
    assert judged.verdict == verdict
    assert "95 % interval" in judged.why


@pytest.mark.parametrize(
    ("value", "spread", "verdict"), [(0.1, 0.2, "agrees"), (3, 0.5, "differs"), (0, 2, "cannot tell")]
)
def test_a_difference_is_within_a_margin_where_its_interval_is(value, spread, verdict):
    judged = within(value, around(value, spread), 1.0, resolution=0.5)
    assert judged.verdict == verdict
    assert ("a query is worth up to 0.5 pp" in judged.why) == (verdict == "cannot tell")


def test_some_and_all_of_several_numbers():
    clear, unclear, low = around([20, 1], 1), around([11, 12], 3), around([1, -3], 1)
    assert some_above([20, 1], clear, 10)[0].verdict == "agrees"
    assert some_above([20, 1], clear, 10)[1].tolist() == [True, False]
    assert some_above([11, 12], unclear, 10)[0].verdict == "cannot tell"
    assert some_above([1, -3], low, 10)[0].verdict == "differs"
    assert all_above([20, 9], around([20, 9], 1), 0).verdict == "agrees"
    assert all_above([20, 1], clear, 0).verdict == "cannot tell"
    assert all_above([1, -5], around([1, -5], 1), 0).verdict == "differs"


def test_many_numbers_need_a_clearer_one():
    """One of forty true zeros is beyond 1.96 deviations by chance; Holm knows."""
    values = np.append(np.zeros(39), 2.2)
    assert some_above(values[-1:], around(values[-1:], 1), 0)[0].verdict == "agrees"
    assert some_above(values, around(values, 1), 0)[0].verdict == "cannot tell"


def test_methods_change_places_only_if_both_differences_are_beyond_chance():
    recall, dar = np.array([90.0, 80.0]), np.array([30.0, 50.0])
    sure, unsure = around(recall, 1), around(recall, 20)
    assert changes_places(recall, dar, (sure, around(dar, 1, seed=1)), "xx")[0].verdict == "agrees"
    assert changes_places(recall, dar, (unsure, around(dar, 1, seed=1)), "xx")[0].verdict == "cannot tell"
    assert changes_places(recall, dar[::-1], (sure, around(dar[::-1], 1, seed=1)), "xx")[0].verdict == "differs"
    assert changes_places(recall, dar, (sure, sure), "xy")[0].why == "one method has no order"


def test_a_claim_of_parts_is_as_its_worst_part():
    yes, no, open_ = above(5, around(5, 1), 0), above(-5, around(-5, 1), 0), above(0, around(0, 1), 0)
    assert first_of(yes, yes).verdict == "agrees"
    assert first_of(yes, open_).verdict == "cannot tell"
    assert first_of(yes, open_, no) == no


@pytest.mark.parametrize(
    ("yes", "no", "verdict"), [(40, 14, "agrees"), (14, 40, "differs"), (8, 7, "cannot tell"), (2, 0, "cannot tell")]
)
def test_most_pairs_are_more_than_half_of_them_beyond_chance(yes, no, verdict):
    assert mostly(np.repeat([True, False], [yes, no])).verdict == verdict


def test_more_pairs_with_one_than_with_another():
    """As the paper counts: 46 of 54 pairs rise with INLP, 18 with STD; nothing can be told from two pairs."""
    inlp, std = np.arange(54) < 46, np.arange(54) < 18
    assert more_often(inlp, std).verdict == "agrees"
    assert more_often(std, inlp).verdict == "differs"
    assert more_often(inlp, inlp).verdict == "cannot tell"
    assert more_often(np.array([True, True]), np.array([False, False])).verdict == "cannot tell"


def recall_study(rates, n=400, seed=0):
    """Table III of two datasets where methods have given chances of a hit without and with distractors."""
    rows, sample, rng = [], [], np.random.default_rng(seed)
    for name in ("one", "two"):
        for method, (recall, dar) in rates.items():
            hits = rng.random(n) < recall
            kept = hits & (rng.random(n) < dar / recall)
            rows.append(
                {"dataset": name, "title": name, "method": method, "R": 100 * hits.mean(), "DAR": 100 * kept.mean()}
            )
            rows[-1]["RSR"] = 100 * kept.mean() / hits.mean()
            sample.append(100 * replicates(np.stack([hits, kept], axis=1), np.arange(n)[:, None], 1.0, stream=name))
    return Study(pd.DataFrame(rows), (), dict(zip(("R", "DAR"), np.stack(sample, axis=1), strict=True)))


def test_findings_on_recall():
    swapped = recall_study({"a": (0.95, 0.2), "b": (0.8, 0.6), "c": (0.5, 0.45)})
    for claim in (
        pages.recall.ranking_changes,
        pages.recall.mean_ranking_changes,
        pages.recall.distractors_lower_recall,
    ):
        assert claim(swapped, TITLES).verdict == "agrees"
    same = recall_study({"a": (0.95, 0.9), "b": (0.7, 0.6), "c": (0.5, 0.35)})
    assert pages.recall.ranking_changes(same, TITLES).verdict == "differs"
    assert "on 0 of 2 datasets" in pages.recall.ranking_changes(same, TITLES).found
    close = recall_study({"a": (0.82, 0.7), "b": (0.8, 0.2)})
    assert pages.recall.similar_recall_hides_differences(close, TITLES).verdict == "agrees"
    assert pages.recall.similar_recall_hides_differences(same, TITLES).verdict == "cannot tell"
    alone = recall_study({"a": (0.9, 0.8)})
    assert pages.recall.ranking_changes(alone, TITLES).found == "one method has no ranking"
    assert "1 claims 0 agree, 0 differ, 1 cannot be told" in pages.common.tally(
        [pages.recall.mean_ranking_changes(alone, TITLES)]
    )


def test_chances_of_ranks_sum_to_one_and_name_the_clear_winner():
    study = recall_study({"a": (0.95, 0.8), "b": (0.6, 0.5), "c": (0.6, 0.5)})
    chances = studies.how_sure.rank_chances(study, "DAR")
    assert chances["method"].tolist() == ["a", "b", "c"]
    np.testing.assert_allclose(chances[["1", "2", "3"]].sum(axis=1), 100)
    assert chances["1"].tolist() == [100, 0, 0]
    assert 5 < chances["2"][1] < 95
    apart = studies.how_sure.separable(study, "DAR")
    assert dict(zip(zip(apart["better"], apart["worse"], strict=True), apart["certain"], strict=True))["a", "b"]
    assert apart["certain"].sum() == 2
    assert "2 of 3 pairs" in pages.how_sure.separable_table(apart, TITLES, heading="DAR@1").data
    assert "100 %" in pages.how_sure.rank_table(chances, TITLES, heading="DAR@1").data


def curve(dataset, distances, dar, left):
    """Fig. 6b of one dataset and two methods with little noise."""
    rows = [
        {"dataset": dataset, "title": dataset, "method": method, "distance": d, "DAR": value, "distractors": number}
        for method in "ab"
        for d, value, number in zip(distances, dar, left, strict=True)
    ]
    table = pd.DataFrame(rows)
    return Study(table, (), {"DAR": around(table["DAR"].to_numpy(), 0.3)})


def test_near_distractors_are_judged_per_distractor_on_all_datasets():
    distances = [25.0, 50.0, 75.0, np.inf]
    first = curve("first", distances, [20, 40, 50, 90], [100, 80, 60, 0])
    assert pages.distractors.near_distractors_hurt_most(first, TITLES).verdict == "agrees"
    # A larger gain, but from many more distractors.
    many = curve("many", distances, [20, 40, 50, 90], [100, 20, 15, 0])
    assert pages.distractors.near_distractors_hurt_most(many, TITLES).verdict == "differs"
    both = pages.distractors.near_distractors_hurt_most(studies.common.joined([first, many]), TITLES)
    assert "on 1 of 2 datasets (first)" in both.found
    assert pages.distractors.far_distractors_still_hurt(first, TITLES).verdict == "agrees"
    table = pages.distractors.gains_table(studies.common.joined([first, many]), TITLES).data
    assert table.count("<tr>") == 1 + 4


def test_mean_distractors_left_are_counted():
    positions = np.array([[0.0], [10.0], [20.0], [30.0]])
    codes = np.eye(4, dtype=np.float32)
    result = evaluate(codes, codes, positions, positions, 5.0)
    left = studies.distractors._distractors_left(result, [5.0, 10.0, 25.0, np.inf])
    brute = [(np.abs(positions - positions.T) > d).sum(axis=1).mean() for d in (5.0, 10.0, 25.0)]
    np.testing.assert_allclose(left, [*brute, 0.0])


def test_findings_on_conditions():
    rows = {"sun": 20, "rain": 50, "night": 85, "none": 90}
    table = pd.DataFrame(
        [{"method": m, "traversal": c, "condition": c, "DAR": v} for m in "ab" for c, v in rows.items()]
    )
    for spread, verdict in ((0.5, "agrees"), (40, "cannot tell")):
        study = Study(table, (), {"DAR": around(table["DAR"].to_numpy(), spread)})
        found = [
            pages.distractors.own_condition_hurts_most(study, TITLES, ("sun", "night")),
            pages.distractors.conditions_between_hurt_less(study, ("sun", "night")),
            pages.distractors.database_condition_hurts_little(study, ("sun", "night")),
        ]
        assert [one.verdict for one in found] == [verdict] * 3
    assert pages.distractors.database_condition_hurts_little(study, ("sun", "fog")).verdict == "cannot tell"


def test_every_claim_has_its_page_and_its_function():
    with (files("artifact.pages") / "claims.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    parts = [
        pages.recall,
        pages.distractors,
        pages.suppression,
        pages.composition,
        pages.mixed_database,
        pages.embedding,
    ]
    for row in rows:
        assert row["page"] in pages.common.PAGES
        assert sum(hasattr(part, row["name"]) for part in parts) == 1, row["name"]
    assert len({row["claim"] for row in rows}) == len(rows)


def test_queries_by_themselves_add_up_to_the_shares(tmp_path, monkeypatch):
    one = synthetic.described()
    synthetic.offer(monkeypatch, one)
    manifest = synthetic.manifest(tmp_path, one)
    names, methods = ["made"], [synthetic.METHOD]
    table = studies.per_query.per_query(manifest, names, methods).table
    assert list(table) == list(studies.per_query.COLUMNS)
    expected = studies.recall.recall_table(manifest, names, methods).table.iloc[0]
    assert 100 * (table["rank"] == 1).mean() == pytest.approx(expected["R"])
    assert 100 * (table["rank_with_distractors"] == 1).mean() == pytest.approx(expected["DAR"])
    positions = one.dataset.query.positions
    for row in table.iloc[::17].to_dict("records"):
        query, best = (int(row[part].removesuffix(".png")) for part in ("query", "best_positive"))
        similarity = one.database.values @ one.query.values[query]
        near = np.linalg.norm(positions - positions[query], axis=1) <= one.dataset.threshold
        assert best == np.flatnonzero(near)[similarity[near].argmax()]
        assert row["similarity"] == pytest.approx(similarity[best], abs=1e-4)
        others = one.query.values @ one.query.values[query]
        assert row["outranking_distractors"] == (others[~near] > similarity[best]).sum()
        assert row["outranking"] == row["outranking_distractors"] + (similarity > similarity[best]).sum()
    views = studies.per_query.per_query_suppressed(manifest, names, methods, iterations=2).table
    changes = studies.suppression.suppression_table(manifest, names, methods, iterations=2).table.set_index(
        "suppression"
    )
    for view, part in views.groupby("view"):
        assert 100 * (part["rank_with_distractors"] == 1).mean() == pytest.approx(changes.loc[view, "DAR"])
        assert set(part["best_positive"]) <= set(one.dataset.database.image_names)


def test_replicates_of_changes_are_around_the_changes(tmp_path, monkeypatch):
    one = synthetic.described()
    synthetic.offer(monkeypatch, one)
    study = studies.suppression.suppression_table(
        synthetic.manifest(tmp_path, one), ["made"], [synthetic.METHOD], iterations=2
    )
    for column, sample in study.replicates.items():
        np.testing.assert_allclose(sample.mean(axis=1), study.table[column], atol=1.5)
    assert (study.replicates["change_DAR"][0] == 0).all(), "the original does not change"
    found = pages.suppression.of_changes(study, {synthetic.METHOD: "Coded"})
    assert {one.claim: one.verdict for one in found}["R@1 improves on Nordland in all cases."] == "cannot tell"


def test_a_larger_pool_counts_as_the_mean_of_smaller_ones():
    """Fig. 7 with pools of different sizes: the mean of DAR over all choices of as many images as the smallest has."""
    rng = np.random.default_rng(5)
    queries, noise, pool = (rng.normal(size=(n, 4)).astype(np.float32) for n in (12, 12, 5))
    database = queries + noise
    where, there = np.arange(12.0)[:, None] * 100, np.full((5, 1), 1e4)

    def evaluated(rows):
        return evaluate(queries, database, where, where, 1.0, {"p": pool[rows]}, {"p": there[rows]}, draws=20)

    expected = np.mean([evaluated(list(rows)).dar(1) for rows in itertools.combinations(range(5), 3)])
    chances, spread = studies.distractors._of_size(evaluated(slice(None)), 3, 1)
    assert chances.mean() == pytest.approx(expected)
    assert spread["draw_low"] < 100 * expected < spread["draw_high"]
    hits, spread = studies.distractors._of_size(evaluated(slice(None)), 5, 1)
    assert (hits.dtype, spread) == (bool, {})


def test_the_tally_of_the_opening_page_is_what_reproduce_prints(tmp_path):
    loaded = synthetic.manifest(tmp_path)
    (tmp_path / "book" / "executed").mkdir(parents=True)
    assert build.tally(loaded) == ""
    shown = pages.opening.tally([pages.recall.mean_ranking_changes(recall_study({"a": (0.9, 0.8)}), TITLES)])
    cells = [{"outputs": []}, {"outputs": [{"data": {"text/html": [shown.data]}}]}]
    (tmp_path / "book" / "executed" / "opening.ipynb").write_text(json.dumps({"cells": cells}))
    assert build.tally(loaded) == "Of 1 claims 0 agree, 0 differ, 1 cannot be told."


def test_the_page_of_taken_queries_holds_each_image_once_and_nothing_that_runs(tmp_path, monkeypatch):
    one = synthetic.described()
    synthetic.offer(monkeypatch, one)
    measured, rows = studies.per_query.taken(synthetic.manifest(tmp_path, one), "made", synthetic.METHOD, 5)
    data = measured.dataset
    assert 0 < len(rows) <= 5 < rows["of"].iloc[0]
    assert (rows["away"] > data.threshold).all()
    similarity = one.query.values @ one.query.values.T
    for row in rows.to_dict("records"):
        own = one.query.values[row["query"]] @ one.database.values[row["positive"]]
        assert similarity[row["query"], row["distractor"]] > own
    hidden = pages.taken.browser({("made", "m"): (measured, rows)}, {"m": "M"})
    assert "no images are on this machine" in hidden.data
    for traversal in data.traversals.values():
        for name in traversal.image_names:
            place = tmp_path / traversal.name / name
            place.parent.mkdir(exist_ok=True)
            Image.new("RGB", (8, 6), (90, 120, 30)).save(place)
    here = {name: dataclasses.replace(t, folder=tmp_path / name) for name, t in data.traversals.items()}
    title = "</script><script>alert(1)</script>"
    hostile = dataclasses.replace(measured, dataset=dataclasses.replace(data, traversals=here, title=title))
    html = pages.taken.browser(
        {("made", "m"): (hostile, rows), ("made", "n"): (hostile, rows)}, {"m": "M", "n": "N"}
    ).data
    assert html.count("<script") == html.count("</script>") == 2
    content = json.loads(re.search(r'<script type="application/json">(.*?)</script>', html)[1])
    assert len(content["cases"]) == 2 * len(rows)
    wanted = {(side, row[part]) for row in rows.to_dict("records") for part, side in SIDES.items()}
    assert len(content["images"]) == len(wanted)


SIDES = {"query": "day", "positive": "night", "distractor": "day"}


def test_a_large_table_is_offered_compressed():
    frame = pd.DataFrame({"query": range(1000)})
    html = pages.common.download(frame, "queries", compressed=True).data
    content = base64.b64decode(
        re.search(r'download="queries.csv.gz" href="data:application/gzip;base64,([^"]+)"', html)[1]
    )
    pd.testing.assert_frame_equal(pd.read_csv(io.BytesIO(content), compression="gzip"), frame)
    assert len(content) < 3000


@pytest.mark.parametrize(
    ("erased_minus_original", "verdict"),
    [((6.0, -4.0), "differs"), ((6.0, 0.5), "agrees"), ((6.0, -1.2), "cannot tell")],
)
def test_what_one_condition_pair_gains_hides_no_harm_to_another(erased_minus_original, verdict):
    difference = -np.repeat(erased_minus_original, 2)  # of two methods each
    table = pd.DataFrame({"suppression": "LEACE", "pair": ["day–rain"] * 2 + ["day–dusk"] * 2, "queries": 200})
    table[["difference_DAR", "difference_R"]] = np.stack([difference, np.zeros(4)], axis=1)
    sample = {"difference_DAR": around(difference, 0.3), "difference_R": around(np.zeros(4), 0.3)}
    found = pages.composition.leace_leaves_others_unharmed(Study(table, (), sample))
    assert found.verdict == verdict
    assert "DAR +6.0 on day–rain" in found.found
