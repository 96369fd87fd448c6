"""The transcribed numbers of the paper agree with each other, before any data exists."""

import numpy as np
import pandas as pd
import pytest

from artifact.studies import reported

METHODS = [
    "anyloc",
    "boq",
    "cosplace",
    "cricavpr",
    "eigenplaces",
    "megaloc",
    "mixvpr",
    "salad",
    "salad_cm",
    "selavpr",
    "selavprpp",
]
DATASETS = list(reported.EVALUATED_QUERIES)


def half_unit(printed):
    """Half a unit of the last printed digit: three significant digits, but two decimals at most."""
    return 0.05 if printed >= 10 else 0.005


@pytest.fixture(scope="module")
def table():
    return reported.recall_table().set_index(["dataset", "method"])


@pytest.fixture(scope="module")
def scatter():
    return reported.table("fig05").set_index(["dataset", "method"])


def test_every_cell_is_there(table, scatter):
    assert len(table) == 7 * 11
    assert not table.isna().any().any()
    assert set(scatter.index) == {(d, m) for d in DATASETS for m in METHODS}
    for name in reported.TABLES:
        assert len(reported.table(name)) > 0
    counts = {"fig06_number": 11 * 11, "fig06_distance": 11 * 7, "fig07": 11 * 5, "fig10": 2 * 3 * 11}
    for name, count in counts.items():
        assert len(reported.table(name)) == count
        assert not reported.table(name).duplicated(reported.table(name).columns[:-1]).any()


def test_table_cells_are_the_rounded_scatter_points(table, scatter):
    for key, row in scatter.iterrows():
        assert table.loc[key, "R@1"] == pytest.approx(
            row.recall_percent, abs=0.0501 if row.recall_percent >= 10 else 0.0051
        )
        assert table.loc[key, "DAR@1"] == pytest.approx(
            row.dar_percent, abs=0.0501 if row.dar_percent >= 10 else 0.0051
        )


def test_rsr_is_dar_over_recall(table, scatter):
    for (dataset, method), row in scatter.iterrows():
        printed = table.loc[(dataset, method), "RSR@1"]
        low = 100 * (row.dar_percent - 0.005) / (row.recall_percent + 0.005)
        high = 100 * (row.dar_percent + 0.005) / (row.recall_percent - 0.005)
        assert low - half_unit(printed) - 1e-9 <= printed <= high + half_unit(printed) + 1e-9


def test_dar_never_exceeds_recall(scatter):
    assert (scatter.dar_percent <= scatter.recall_percent).all()


def test_means_are_over_the_six_datasets(table, scatter):
    for method in METHODS:
        cells = scatter.xs(method, level="method")
        assert table.loc[("mean", method), "R@1"] == pytest.approx(cells.recall_percent.mean(), abs=0.0551)
        assert table.loc[("mean", method), "DAR@1"] == pytest.approx(cells.dar_percent.mean(), abs=0.0551)
        rsr = (100 * cells.dar_percent / cells.recall_percent).mean()
        assert table.loc[("mean", method), "RSR@1"] == pytest.approx(rsr, abs=0.0651)
    lines = reported.table("fig05_means").set_index("dataset")
    for dataset in DATASETS:
        cells = scatter.xs(dataset, level="dataset")
        assert lines.loc[dataset, "recall_percent"] == pytest.approx(cells.recall_percent.mean(), abs=0.0101)
        assert lines.loc[dataset, "dar_percent"] == pytest.approx(cells.dar_percent.mean(), abs=0.0101)


def test_ranks_follow_the_means():
    cells = reported.table("tab03")
    means = cells[cells.dataset == "mean"]
    for _, column in means.groupby("metric"):
        ordered = column.sort_values("percent", ascending=False)
        assert sorted(column["rank"]) == list(range(1, 12))
        np.testing.assert_array_equal(ordered["rank"], np.arange(1, 12))


def test_marks_follow_the_scatter(scatter):
    """Best, second and worst of each column; where two methods tie, both carry the mark."""
    cells = reported.table("tab03")
    for dataset in DATASETS:
        for metric, name in (("R@1", "recall_percent"), ("DAR@1", "dar_percent")):
            values = scatter.xs(dataset, level="dataset")[name]
            column = cells[(cells.dataset == dataset) & (cells.metric == metric)].set_index("method")
            levels = sorted(values.unique(), reverse=True)
            for mark, level in (("best", levels[0]), ("second", levels[1]), ("worst", levels[-1])):
                assert set(column.index[column["mark"] == mark]) == set(values.index[values == level]), (
                    dataset,
                    metric,
                    mark,
                )


def test_percentages_are_whole_numbers_of_queries(scatter):
    """Every printed percentage is k / N; on RobotCar only N = 5,987 fits, not the 6,021 of Table I."""

    def fits(percentages, n):
        counts = np.rint(percentages * n / 100)
        return np.abs(100 * counts / n - percentages) <= 0.005 + 1e-9

    for dataset, n in reported.EVALUATED_QUERIES.items():
        values = scatter.xs(dataset, level="dataset").to_numpy().ravel()
        assert fits(values, n).all(), dataset
    robotcar = scatter.xs("robotcar", level="dataset").to_numpy().ravel()
    assert not fits(robotcar, 6021).all()
    curves = pd.concat([reported.table(n).dar_percent for n in ("fig06_distance", "fig07")])
    assert fits(curves.to_numpy(), 5987).mean() > 0.99
    assert reported.table("tab01").set_index("dataset").queries["robotcar"] == 6021


def test_curves_end_at_the_table_cells(scatter):
    robotcar = scatter.xs("robotcar", level="dataset")
    number = reported.table("fig06_number").pivot(index="method", columns="ratio", values="dar_percent")
    distance = reported.table("fig06_distance").pivot(
        index="method", columns="minimum_distance_metres", values="dar_percent"
    )
    condition = reported.table("fig07").pivot(index="method", columns="distractor_condition", values="dar_percent")
    for method in METHODS:
        dar, recall = robotcar.loc[method, "dar_percent"], robotcar.loc[method, "recall_percent"]
        assert number.loc[method, 1.0] == distance.loc[method, 25.0] == condition.loc[method, "sun,clouds"] == dar
        # SelaVPR is printed as 98.21 in one panel and 98.18 elsewhere.
        assert number.loc[method, 0.0] == pytest.approx(recall, abs=0.031)
        assert distance.loc[method, np.inf] == condition.loc[method, "none"] == recall


def test_curves_are_monotone_as_they_must_be():
    for name, x, sign in (("fig06_number", "ratio", -1), ("fig06_distance", "minimum_distance_metres", 1)):
        for _, curve in reported.table(name).groupby("method"):
            steps = np.diff(curve.sort_values(x).dar_percent)
            assert (sign * steps >= 0).all()


def test_claims_of_the_text_follow_from_the_numbers(table):
    """Numbers that the paper's prose quotes are the numbers of its tables."""
    ranks = reported.table("tab03").query("dataset == 'mean'").pivot(index="method", columns="metric", values="rank")
    assert (ranks.loc["salad_cm", "R@1"], ranks.loc["salad_cm", "DAR@1"]) == (4, 1)
    assert (ranks.loc["cricavpr", "R@1"], ranks.loc["cricavpr", "DAR@1"]) == (5, 7)
    mixed = reported.table("fig02").pivot(index="method", columns="database", values="recall_percent")
    assert (mixed["single-condition"] - mixed["mixed-condition"]).max() == pytest.approx(15.4)
    maps = reported.table("fig09").pivot(index="method", columns="descriptors", values="recall_percent")
    gain = maps["suppressed"] - maps["original"]
    assert gain["anyloc"] == pytest.approx(16.4, abs=0.11)
    assert gain["eigenplaces"] == pytest.approx(5.1)
    order = reported.table("fig07").groupby("distractor_condition").dar_percent.mean().sort_values()
    assert list(order.index) == ["sun,clouds", "overcast", "rain", "night", "none"]
    start = reported.table("fig10").query("fitting_fraction == 0")
    assert (start.change_pp == 0).all()
    assert len(start) == 6
