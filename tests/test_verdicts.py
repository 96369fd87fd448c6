"""Verdicts follow the rules that the page states, at the precision that the paper printed."""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artifact import evaluate, manifest
from artifact.extraction import made
from artifact.metrics.statistics import intervals
from artifact.studies import reported, verdicts
from artifact.studies.judging import CLOSE_PP, judge

LISTED = dict(zip(*(reported.table("tab01")[column] for column in ("dataset", "queries")), strict=True))


@pytest.fixture(scope="module")
def exact():
    """Table III as a run would measure it whose hits are exactly the paper's."""
    table = reported.recall_table()
    table = table[table["dataset"] != "mean"]
    rows = []
    for row in table.to_dict("records"):
        n = reported.EVALUATED_QUERIES[row["dataset"]]
        hits = {metric: round(row[f"{metric}@1"] * n / 100) for metric in ("R", "DAR")}
        shares = {metric: 100 * count / n for metric, count in hits.items()} | {"RSR": 100 * hits["DAR"] / hits["R"]}
        cells = {
            "dataset": row["dataset"],
            "reported_as": row["dataset"],
            "title": row["dataset"],
            "method": row["method"],
        }
        cells |= {"queries": n, "listed": LISTED[row["dataset"]], "hits_R": hits["R"], "hits_DAR": hits["DAR"]}
        for metric, share in shares.items():
            cells |= {metric: share, f"{metric}_low": share - 1, f"{metric}_high": share + 1}
            cells[f"reported_{metric}"] = row[f"{metric}@1"]
        rows.append(cells)
    return pd.DataFrame(rows)


def test_the_papers_own_hits_are_equal_in_every_cell_and_mean(exact):
    found = verdicts.of_recall(exact)
    assert len(found) == 6 * 11 * 3 + 6 + 11 * 3 + 6 * 2
    assert (found["verdict"] == "equal").all(), found[found["verdict"] != "equal"]


@pytest.mark.parametrize("metric", ["R", "DAR"])
def test_one_query_more_is_not_equal_where_two_decimals_tell_it(exact, metric):
    small = exact[exact["queries"] < 6000].copy()
    small[f"hits_{metric}"] += 1
    small[metric] = 100 * small[f"hits_{metric}"] / small["queries"]
    found = verdicts.of_recall(small)
    changed = found[(found["quantity"] == f"{metric}@1 %") & (found["where"] == "Table III, Fig. 5")]
    assert (changed["verdict"] != "equal").all()


@pytest.mark.parametrize("shift", [-7.0, 3.0])
def test_errors_of_the_protocol_differ(exact, shift):
    """Values that move by more than 1 pp, beyond their interval, differ."""
    wrong = exact.copy()
    for column in ("DAR", "DAR_low", "DAR_high"):
        wrong[column] += shift
    wrong["hits_DAR"] = (wrong["DAR"] * wrong["queries"] / 100).round().astype(int)
    found = verdicts.of_recall(wrong)
    cells = found[(found["quantity"] == "DAR@1 %") & (found["where"] == "Table III, Fig. 5")]
    assert (cells["verdict"] == "differs").all()


@given(st.floats(0, 100), st.floats(0, 100), st.floats(0.01, 20), st.integers(0, 2))
def test_the_four_values_are_the_rule(measured, expected, half_width, digits):
    low, high = measured - half_width, measured + half_width
    verdict = judge(measured, expected, digits=digits, low=low, high=high).verdict
    inside, close = low <= expected <= high, abs(measured - expected) <= CLOSE_PP
    if abs(measured - expected) < 0.5 * 10.0**-digits - 1e-6:
        assert verdict == "equal"
    elif abs(measured - expected) > 0.5 * 10.0**-digits + 1e-6 and abs(abs(measured - expected) - 1) > 1e-6:
        assert verdict == ("agrees" if inside and close else "differs" if not inside and not close else "cannot tell")


def test_what_was_not_measured_cannot_be_told_and_what_the_paper_lacks_is_an_error():
    assert judge(math.nan, 50.0, digits=2).verdict == "cannot tell"
    assert judge(50.0, 52.0, digits=2).why == "no interval could be measured"
    with pytest.raises(ValueError, match="the paper's number is missing"):
        judge(50.0, math.nan, digits=2)


def test_counts_of_pairs_need_all_54_pairs_and_are_compared_in_pairs():
    methods = [m for m in reported.method_titles() if not m.startswith("selavpr")]
    rows = [
        {
            "reported_as": dataset,
            "method": method,
            "suppression": s,
            "change_probe": -1.0,
            "change_DAR": 1.0,
            "change_R": 1.0,
        }
        for dataset in reported.EVALUATED_QUERIES
        for method in methods
        for s in ("INLP", "LEACE", "STD")
    ]
    table = pd.DataFrame(rows)
    inlp = np.flatnonzero(table["suppression"] == "INLP")
    table.loc[inlp[:4], "change_probe"] = 0.5  # 50 of 54, as the paper counts
    found = verdicts.of_counts(table).set_index(["method", "quantity"])
    assert found.loc[("INLP", "pairs whose probe accuracy falls"), "verdict"] == "equal"
    assert found.loc[("STD", "pairs whose probe accuracy falls"), "verdict"] == "differs"
    assert verdicts.of_counts(table[table["reported_as"] != "svox"]).empty


def test_intervals_over_pairs_cover_the_mean_and_repeat():
    values = np.random.default_rng(0).normal(1.0, 2.0, 54)
    low, high = verdicts.over_pairs(np.mean, values)
    assert low < values.mean() < high
    assert (low, high) == verdicts.over_pairs(np.mean, values)
    assert high - low == pytest.approx(2 * 1.96 * 2.0 / 54**0.5, rel=0.35)


def test_a_run_without_the_methods_of_the_maps_has_verdicts_of_the_rest(exact, monkeypatch):
    """RobotCar without AnyLoc and EigenPlaces, the methods of Figs. 2 and 9."""
    table = exact[(exact["dataset"] == "robotcar") & (exact["method"] == "boq")]
    monkeypatch.setattr(verdicts.recall, "recall_table", lambda *_, **__: SimpleNamespace(table=table))
    for study in ("distractor_number", "distractor_distance", "distractor_condition"):
        monkeypatch.setattr(verdicts.distractors, study, lambda *_, **__: SimpleNamespace(table=None))
    monkeypatch.setattr(verdicts, "of_curve", lambda *_: verdicts.of_recall(table[:0]))
    found = verdicts.of_profile(manifest.load(), ["robotcar"], ["boq"])
    assert len(found) == 3 + 1
    assert (found["verdict"] == "equal").all()


# -- errors of the protocol, planted at full size -------------------------------------------------------------------


@pytest.fixture(scope="module")
def full_size():
    """RobotCar and Nordland at the paper's sizes with made descriptors: what a right run measures, and how."""
    loaded = manifest.load()
    found = {}
    # Places that look alike over several frames: the tolerance then decides about many queries.
    for name, images, alike in (("robotcar", (6021, 7513), 2), ("nordland", (3000, 3000), 6)):
        entry = loaded.dataset(name)
        strength = made.Strength(1.9, 0.7)
        sides = []
        for traversal, n in zip((entry.query, entry.database), images, strict=True):
            along, positions = made.route(entry, traversal, n)
            sides.append((made.descriptors(entry, traversal, "boq", along / alike, strength), positions))
        found[name] = (entry, *sides)
    return found


def share_of(evaluation):
    """R@1 and DAR@1 in percent with their intervals and hits."""
    cells = {}
    for metric, interval in intervals(evaluation).items():
        cells[metric] = 100 * interval.value, 100 * interval.low, 100 * interval.high
    hits = [int(evaluation.hits(1, distractors=d).sum()) for d in (False, True)]
    return cells, dict(zip(("R", "DAR"), hits, strict=True)), evaluation.n_queries


def verdicts_against(right, wrong):
    """Verdicts of a wrong run where the right one stands for the paper."""
    (expected, _, n), (cells, hits, n_wrong) = share_of(right), share_of(wrong)
    found = []
    for metric in ("R", "DAR"):
        value, low, high = cells[metric]
        paper = round(expected[metric][0], 2)
        facts = {"low": low, "high": high, "hits": (hits[metric], n_wrong), "expected_queries": n}
        found.append(judge(value, paper, digits=2, **facts).verdict)
    return found


def test_a_right_run_is_equal_and_planted_errors_differ(full_size):
    entry, (queries, places), (database, where) = full_size["robotcar"]
    thr = entry.threshold.value
    right = evaluate(queries, database, places, where, thr)
    assert right.excluded_queries == 34
    assert verdicts_against(right, evaluate(queries, database, places, where, thr)) == ["equal", "equal"]
    doubled = evaluate(queries, database, places, where, 2 * thr)
    assert "differs" in verdicts_against(right, doubled)
    swapped = evaluate(database, queries, where, places, thr)
    assert "differs" in verdicts_against(right, swapped)
    # Distractors of the query's own place are kept: the pool stands far from every query, so that none is left out.
    kept = evaluate(queries, database, places, where, thr, queries, np.add(places, [1e7, 0]))
    assert verdicts_against(right, kept)[1] == "differs"


def test_a_frame_tolerance_off_by_one_differs(full_size):
    entry, (queries, places), (database, where) = full_size["nordland"]
    right = evaluate(queries, database, places, where, entry.threshold.value)
    for tolerance in (entry.threshold.value - 1, entry.threshold.value + 1):
        wrong = evaluate(queries, database, places, where, tolerance)
        assert "differs" in verdicts_against(right, wrong), tolerance


def test_counting_queries_without_a_positive_differs():
    assert verdicts.of_evaluated(6021, 5987, "robotcar").verdict == "equal"
    assert verdicts.of_evaluated(6021, 6021, "robotcar").verdict == "differs"
    assert verdicts.of_evaluated(6019, 5985, "robotcar").verdict == "cannot tell"
