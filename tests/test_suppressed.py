"""Studies of suppression on descriptors whose cause is known: a condition along one direction."""

import dataclasses
import functools

import numpy as np
import pandas as pd
import pytest
import synthetic

from artifact import compose, evaluate, pages, studies
from artifact.manifest.entries import ManifestError
from artifact.studies import evaluated, fitted, within_session
from artifact.studies.common import NothingToShowError
from artifact.suppression.inlp import INLP
from artifact.suppression.leace import LEACE
from artifact.suppression.std import STD


@pytest.fixture
def made(tmp_path, monkeypatch):
    one = synthetic.described()
    synthetic.offer(monkeypatch, one)
    return synthetic.manifest(tmp_path, one), one


@pytest.fixture
def two(tmp_path, monkeypatch):
    first, second = synthetic.described(), synthetic.described(seed=5, name="other", turn=3)
    synthetic.offer(monkeypatch, first, second)
    return synthetic.manifest(tmp_path, first, second), {"made": first, "other": second}


def by_hand(one, region, transform=None):
    """Evaluate the evaluation region after transforming the descriptors themselves."""
    queries, database = one.query.values[region.evaluation_queries], one.database.values[region.evaluation_database]
    if transform is not None:
        queries, database = transform.transform(queries), transform.transform(database)
    places = one.dataset.query.positions, one.dataset.database.positions
    return evaluate(
        queries,
        database,
        places[0][region.evaluation_queries],
        places[1][region.evaluation_database],
        one.dataset.threshold,
    )


def test_the_table_holds_what_fitting_and_evaluating_by_hand_give(made):
    manifest, one = made
    table = studies.suppression.suppression_table(manifest, ["made"], [synthetic.METHOD], iterations=5).table.set_index(
        "suppression"
    )
    region = fitted.split_of(one.dataset, 0.1)
    X, condition = fitted.fitting_data(one, region)
    assert (condition == 0).sum() == len(region.fit_queries) == table.loc["original", "fitted_queries"]
    for name, transform in (("original", None), ("LEACE", LEACE()), ("INLP", INLP(5))):
        expected = by_hand(one, region, None if transform is None else transform.fit(X, condition))
        assert table.loc[name, "R"] == pytest.approx(100 * expected.recall(1))
        assert table.loc[name, "DAR"] == pytest.approx(100 * expected.dar(1))
        assert table.loc[name, "change_DAR"] == pytest.approx(table.loc[name, "DAR"] - table.loc["original", "DAR"])


def standardised_by_hand(one, fit_region, region):
    """Rescale the queries, which are the distractors too, as queries and the database as a database."""
    std = STD().fit(*fitted.fitting_data(one, fit_region))
    queries = std.transform(one.query.values[region.evaluation_queries], fitted.QUERY)
    database = std.transform(one.database.values[region.evaluation_database], fitted.DATABASE)
    places = (one.dataset.query.positions, one.dataset.database.positions)
    rows = region.evaluation_queries, region.evaluation_database
    return evaluate(queries, database, *(p[r] for p, r in zip(places, rows, strict=True)), one.dataset.threshold)


def same_ranks(found, expected):
    for distractors in (False, True):
        np.testing.assert_array_equal(found.ranks(distractors=distractors), expected.ranks(distractors=distractors))


def test_standardised_queries_and_distractors_carry_the_query_condition(made):
    manifest, one = made
    region = fitted.split_of(one.dataset, 0.3)
    found = fitted.compare(manifest, "made", synthetic.METHOD, fraction=0.3, iterations=1).evaluations["STD"]
    same_ranks(found, standardised_by_hand(one, region, region))


def test_every_fraction_is_evaluated_on_the_same_outer_half(made):
    manifest, one = made
    half = fitted.split_of(one.dataset, 0.5)
    found, _ = fitted.by_fraction(manifest, "made", synthetic.METHOD, [0.2, 0.5], iterations=2)
    for (name, fraction), result in found.items():
        np.testing.assert_array_equal(half.evaluation_queries[result.evaluated], half.evaluation_queries)
        np.testing.assert_array_equal(result.query_positions, one.dataset.query.positions[half.evaluation_queries])
        region = fitted.split_of(one.dataset, fraction) if fraction else half
        if name == "STD":
            same_ranks(result, standardised_by_hand(one, region, half))
        else:
            fit = {"original": None, "LEACE": LEACE(), "INLP": INLP(2)}[name]
            same_ranks(result, by_hand(one, half, fit and fit.fit(*fitted.fitting_data(one, region))))


# -- pools of distractors -------------------------------------------------------------------------------------------


@pytest.fixture
def with_excluded(tmp_path, monkeypatch):
    """The last thirty queries have no image of the database near them."""
    one = synthetic.described()
    before = one.dataset.traversals
    night = before["night"].positions.copy()
    night[90:] += [0, 9000]
    traversals = before | {"night": dataclasses.replace(before["night"], positions=night)}
    one = dataclasses.replace(one, dataset=dataclasses.replace(one.dataset, traversals=traversals))
    synthetic.offer(monkeypatch, one)
    return synthetic.manifest(tmp_path, one), one


def test_the_query_traversal_as_a_pool_is_the_evaluated_queries(with_excluded):
    manifest, one = with_excluded
    ask = functools.partial(evaluated.evaluation, manifest, "made", synthetic.METHOD)
    alone, pools = ask().evaluation, ask(distractors=["day", "dusk"]).evaluation
    assert alone.n_queries == alone.n_distractors == pools.pool("day").n_distractors == 91  # one just beyond is near
    np.testing.assert_array_equal(pools.pool_positions["day"], one.dataset.query.positions[:91])
    assert pools.pool("dusk").n_distractors == 120
    same_ranks(pools.pool("day"), alone)


def test_a_pool_of_given_size_is_drawn_at_random(with_excluded):
    manifest, one = with_excluded
    places = {tuple(where): place for place, where in enumerate(one.dataset.traversals["dusk"].positions)}

    def drawn(seed, name):
        options = {"distractors": ["day", "dusk"], "pool_size": 40, "seed": seed}
        result = evaluated.evaluation(manifest, "made", synthetic.METHOD, **options).evaluation
        members = [places[tuple(where)] for where in result.pool_positions[name]]
        assert len(members) == 40
        assert members == sorted(set(members)), "each at most once, in order"
        return members

    for name, size in (("day", 91), ("dusk", 120)):
        pools = [drawn(seed, name) for seed in range(12)]
        assert drawn(3, name) == pools[3]
        assert len(set(map(tuple, pools))) == len(pools)
        assert 0.9 * size < len(set().union(*pools)) <= size, "every image may be drawn"


def test_a_pool_cannot_be_larger_than_its_traversal(with_excluded):
    manifest, _ = with_excluded
    for name, size in (("day", 91), ("dusk", 120)):
        with pytest.raises(
            ValueError, match=f"made/{name} has {size} images for a pool of {size + 1}; ask for at most"
        ):
            evaluated.evaluation(manifest, "made", synthetic.METHOD, distractors=[name], pool_size=size + 1)


# -- suppression ----------------------------------------------------------------------------------------------------


def test_suppression_undoes_a_condition_that_is_one_direction(made):
    manifest, _ = made
    table = studies.suppression.suppression_table(manifest, ["made"], [synthetic.METHOD], iterations=5).table.set_index(
        "suppression"
    )
    assert table.loc["original", "DAR"] < 5
    assert table.loc["original", "probe"] > 99
    for name in ("INLP", "LEACE"):
        assert table.loc[name, "DAR"] > 60
        assert table.loc[name, "probe"] < 75
    counts = studies.suppression.improved(table.reset_index()).set_index("suppression")
    assert counts.loc["LEACE", ["pairs", "probe", "DAR"]].tolist() == [1, 1, 1]


def test_a_second_reading_computes_nothing(made, monkeypatch):
    manifest, _ = made
    first = studies.suppression.suppression_table(manifest, ["made"], [synthetic.METHOD], iterations=5).table
    monkeypatch.setattr("artifact.studies.fitted.fit", None)
    pd.testing.assert_frame_equal(
        first, studies.suppression.suppression_table(manifest, ["made"], [synthetic.METHOD], iterations=5).table
    )


def test_fractions_start_at_the_original_and_share_one_evaluation_half(made):
    manifest, one = made
    study = studies.suppression.fitting_fraction(manifest, ["made"], [synthetic.METHOD], [0.1, 0.5], iterations=3)
    table = study.table
    assert set(table["suppression"]) == {"INLP", "LEACE", "STD"}
    assert (table.loc[table["fraction"] == 0, ["change_R", "change_DAR"]] == 0).all(axis=None)
    half = fitted.split_of(one.dataset, 0.5, evaluation_fraction=0.5)
    X, condition = fitted.fitting_data(one, half)
    expected = by_hand(one, half, LEACE().fit(X, condition)).dar(1) - by_hand(one, half).dar(1)
    found = table.query("suppression == 'LEACE' and fraction == 0.5")["change_DAR"].item()
    assert found == pytest.approx(100 * expected)
    means = studies.suppression.mean_by_fraction(table)
    assert means["pairs"].tolist() == [1] * 9
    found = {one.claim: one.verdict for one in pages.suppression.of_fractions(study)}
    assert found["Fitting on 10 % of the queries lowers the mean R@1 of no suppression method."] == "agrees"
    assert found["INLP and LEACE raise the mean DAR@1 when fitted on 5 % of the queries."] == "cannot tell"


def test_too_small_a_fraction_leaves_a_pair_out_of_the_means(tmp_path, monkeypatch):
    large, small = synthetic.described(), synthetic.described(n=24, name="small")
    synthetic.offer(monkeypatch, large, small)
    manifest = synthetic.manifest(tmp_path, large, small)
    table = studies.suppression.fitting_fraction(
        manifest, ["made", "small"], [synthetic.METHOD], [0.04, 0.3], iterations=2
    ).table
    assert set(table.query("dataset == 'small'")["fraction"]) == {0, 0.3}
    means = studies.suppression.mean_by_fraction(table)
    whole = table.query("dataset == 'made' and suppression == 'LEACE'").set_index("fraction")
    found = means.query("suppression == 'LEACE'").set_index("fraction")
    np.testing.assert_allclose(found["change_DAR"], whole["change_DAR"])
    # A pair that no fraction suits is evaluated without suppression, and nothing is said of any method.
    alone = studies.suppression.fitting_fraction(manifest, ["small"], [synthetic.METHOD], [0.04], iterations=2)
    assert alone.table[["fraction", "change_R", "change_DAR"]].drop_duplicates().to_numpy().tolist() == [[0, 0, 0]]
    assert {one.verdict for one in pages.suppression.of_fractions(alone)} == {"cannot tell"}


def test_the_composed_transform_is_fitted_in_turn_and_erases_both_conditions(two):
    manifest, both = two
    erasure = fitted.sequential(manifest, both, synthetic.METHOD, "LEACE", fitted.Fitting())
    X, condition = fitted.fitting_data(both["made"], fitted.split_of(both["made"].dataset, 0.1))
    first = LEACE().fit(X, condition)
    X, condition = fitted.fitting_data(both["other"], fitted.split_of(both["other"].dataset, 0.1))
    second = LEACE().fit(first.transform(X), condition)
    probe = both["other"].query.values
    np.testing.assert_allclose(erasure.composed.transform(probe), second.transform(first.transform(probe)), atol=1e-5)
    np.testing.assert_allclose(compose(first, second).transform(probe), erasure.composed.transform(probe), atol=1e-5)
    table = studies.composition.single_against_multi(
        manifest, ["made", "other"], [synthetic.METHOD], iterations=5
    ).table
    assert len(table) == 4
    assert (table.query("suppression == 'LEACE'")["multi_DAR"] > 50).all()
    np.testing.assert_allclose(table["difference_DAR"], table["single_DAR"] - table["multi_DAR"])
    summary = studies.composition.summary(table, ["suppression"]).set_index("suppression")
    part = table.query("suppression == 'INLP'")["difference_R"]
    assert summary.loc["INLP", "mean_R"] == pytest.approx(part.mean())
    assert summary.loc["INLP", "std_R"] == pytest.approx(np.std(part, ddof=1))
    assert summary.loc["INLP", "within_R"] == (part.abs() <= 1).sum()


def test_irrelevant_pairs_meet_the_composed_transform_outside_the_fitting_region(two):
    manifest, _ = two
    study = studies.composition.irrelevant_conditions(manifest, ["made", "other"], [synthetic.METHOD], iterations=4)
    table = study.table
    assert table["pair"].unique().tolist() == ["day–dusk"]
    assert len(table) == 4
    # Day and dusk differ little along the direction, so there is little to gain and nothing to lose.
    assert (table.query("suppression == 'LEACE'")["difference_R"] <= 5).all()
    finding = pages.composition.leace_leaves_others_unharmed(study)
    assert finding.page == "tab05"
    rows = (table["suppression"] == "LEACE").to_numpy()
    for metric in ("R", "DAR"):
        middle = np.median(study.replicates[f"difference_{metric}"][rows], axis=1)
        np.testing.assert_allclose(middle, table.loc[rows, f"difference_{metric}"], atol=3)


def test_a_pair_that_was_fitted_leaves_the_composition_for_that_pair(two, monkeypatch):
    """A dataset may be fitted on the very pair of traversals that Table V asks about, under another name."""
    manifest, _ = two
    pair = {"query": "day", "database": "dusk", "root": "made"}
    manifest.datasets["made"] = manifest.datasets["made"].model_copy(update={"root": "made"})
    manifest.datasets["other"] = manifest.datasets["other"].model_copy(update=pair)
    fitted_on = []

    def remember(manifest, names, *args, **options):
        fitted_on.append(list(names))
        raise KeyboardInterrupt

    monkeypatch.setattr("artifact.studies.fitted.sequential", remember)
    with pytest.raises(KeyboardInterrupt):
        studies.composition.irrelevant_conditions(manifest, ["made", "other"], [synthetic.METHOD])
    assert fitted_on == [["made"]]


def test_the_papers_order_of_fitting(tmp_path):
    made = [synthetic.described(n=12, name=name) for name in ("a", "b", "c", "d")]
    manifest = synthetic.manifest(tmp_path, *made)
    names = {"a": {"mirrors": "St Lucia"}, "b": {"mirrors": "Nordland"}, "c": {}, "d": {"reported_as": "amstertime"}}
    for name, update in names.items():
        manifest.datasets[name] = manifest.datasets[name].model_copy(update=update)
    assert studies.composition.order_of_fitting(manifest, ["a", "b", "c", "d"]) == ["b", "d", "a", "c"]


def test_mixed_databases_count_added_images_within_the_threshold_as_right(made):
    manifest, one = made
    mixed = studies.mixed_database.mixed_database(manifest, "made", synthetic.METHOD, share=0.1)
    assert len(mixed.added) == 12
    data = one.dataset
    everything = np.concatenate([one.database.values, one.descriptors["dusk"].values[mixed.added]])
    places = np.concatenate([data.database.positions, data.traversals["dusk"].positions[mixed.added]])
    best = (one.query.values @ everything.T).argmax(axis=1)
    right = np.linalg.norm(data.query.positions - places[best], axis=1) <= data.threshold
    assert mixed.evaluations["mixed"].recall(1) == pytest.approx(right.mean())
    assert mixed.evaluations["single"].recall(1) > mixed.evaluations["mixed"].recall(1)
    table = studies.mixed_database.mixed_table({synthetic.METHOD: mixed})
    assert table.query("evaluation == 'mixed'")["retrieved"].tolist() == best.tolist()
    finding = pages.mixed_database.few_images_lower_recall({synthetic.METHOD: mixed}, {synthetic.METHOD: "Coded"})
    assert finding.verdict == "agrees"
    assert mixed.hits["mixed"].shape == (mixed.evaluations["single"].n_queries, studies.mixed_database.DRAWS)
    assert mixed.recalls("mixed")[0] == pytest.approx(100 * right.mean())
    assert len(set(mixed.recalls("mixed"))) > 1, "other images, another recall"


def test_suppression_of_a_mixed_database_keeps_the_fitted_places_out(made):
    manifest, one = made
    found = studies.mixed_database.mixed_database_suppressed(
        manifest, "made", synthetic.METHOD, share=0.2, iterations=4
    )
    data = one.dataset
    fitted = data.query.positions[found.fitted_queries]
    added = data.traversals["dusk"].positions[found.added]
    assert np.linalg.norm(fitted[:, None] - added[None], axis=2).min() > data.threshold
    assert not set(found.queries) & set(found.fitted_queries)
    assert found.evaluations["INLP"].recall(1) > found.evaluations["original"].recall(1) + 0.1
    assert pages.mixed_database.suppression_helps_mixed_database({"m": found}, {"m": "Coded"}).verdict == "agrees"


def test_a_mixed_database_needs_a_traversal(tmp_path, monkeypatch):
    one = synthetic.described(extra=())
    synthetic.offer(monkeypatch, one)
    with pytest.raises(ManifestError, match="same_condition_traversal"):
        studies.mixed_database.mixed_database(synthetic.manifest(tmp_path, one), "made", synthetic.METHOD)


@pytest.mark.slow
def test_umap_mixes_the_conditions_after_suppression(made):
    manifest, _ = made
    one = studies.embedding.embedding(manifest, "made", synthetic.METHOD, iterations=4)
    assert one.before.shape == one.after.shape == (len(one.before), 2)
    assert studies.embedding.nearest_share(one.before, one) < 0.05 < studies.embedding.nearest_share(one.after, one)
    assert (one.partners[:, 0] < one.n_queries).all()
    assert (one.partners[:, 1] >= one.n_queries).all()
    assert len(studies.embedding.embedding_table(one)) == len(one.before)


def test_what_is_erased_follows_every_iteration(made):
    manifest, one = made
    erased = studies.erased.what_is_erased(manifest, "made", synthetic.METHOD, iterations=4)
    region = erased.split
    X, condition = fitted.fitting_data(one, region)
    inlp = INLP(4).fit(X, condition)
    for step in range(5):
        expected = by_hand(one, region, inlp.at(step))
        row = erased.iterations.set_index("iteration").loc[step]
        assert row["DAR"] == pytest.approx(100 * expected.dar(1))
        assert row["R"] == pytest.approx(100 * expected.recall(1))
    np.testing.assert_allclose(erased.iterations["accuracy"][:4], 100 * inlp.accuracies_)
    lost, recovered = erased.lost_and_recovered("LEACE")
    assert set(recovered) <= set(lost)
    assert len(recovered) > 0.5 * len(lost) > 0
    winner = erased.evaluations["original"].retrieved(1, distractors=True)[0][lost, 0]
    assert (winner >= len(region.evaluation_database)).all()


def test_similarities_of_pairs_move_apart(made):
    manifest, _ = made
    found = studies.erased.what_is_erased(manifest, "made", synthetic.METHOD, iterations=2).similarities
    positive, distractor, other = studies.erased.KINDS
    means = {view: {kind: values.mean() for kind, values in kinds.items()} for view, kinds in found.items()}
    assert means["original"][distractor] > means["original"][positive] > means["original"][other]
    assert means["LEACE"][positive] > means["LEACE"][distractor]
    assert all(np.abs(values).max() <= 1 + 1e-5 for kinds in found.values() for values in kinds.values())


def brightness_described(effect, n=160, d=48, seed=1):
    """A drive whose images carry a brightness that changes from image to image; the descriptor encodes it or not."""
    one = synthetic.described(n=n, d=d, push=0.0, noise=0.75, extra=(), seed=seed)
    bright = np.random.default_rng(7).uniform(0, 1, n)
    direction = np.linalg.qr(np.random.default_rng(8).standard_normal((d, 1)))[0][:, 0]
    values = one.query.values + effect * (bright[:, None] - 0.5) * direction
    values = (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)
    found = dict(one.descriptors)
    found["day"] = type(one.query)(values, "day", f"day {effect}", "images", {})
    return type(one)(one.dataset, one.method, found), np.column_stack([bright] * 4)


def gaps(tmp_path, monkeypatch, effect):
    one, measures = brightness_described(effect)
    synthetic.offer(monkeypatch, one)
    monkeypatch.setattr(within_session, "appearance", lambda *_: measures)
    table = studies.within_session.within_session(
        synthetic.manifest(tmp_path, one), ["made"], [synthetic.METHOD], fraction=0.3, iterations=3
    ).table
    return table.set_index("view")


def test_a_brightness_that_descriptors_encode_takes_queries_and_can_be_suppressed(tmp_path, monkeypatch):
    table = gaps(tmp_path, monkeypatch, effect=1.6)
    before, after = table.loc["original"], table.loc["LEACE"]
    assert before["gap"] == pytest.approx(before["other"] - before["own"])
    assert before["gap"] > before["control_high"]
    assert before["gap_low"] > 0
    assert abs(before["control"]) < 5
    assert after["gap"] < before["gap"] / 2


def test_a_brightness_that_descriptors_ignore_takes_none(tmp_path, monkeypatch):
    row = gaps(tmp_path, monkeypatch, effect=0.0).loc["original"]
    assert row["gap_low"] <= 0 <= row["gap_high"]
    assert row["R"] >= row["own"]


def test_sides_are_halves_and_turns_keep_them():
    values = np.random.default_rng(0).permutation(41)
    labels = within_session.sides(values)
    assert labels.sum() == 21
    assert values[labels == 1].min() > values[labels == 0].max()
    for turn in within_session.turned(labels):
        assert turn.sum() == labels.sum()
    np.testing.assert_array_equal(within_session.turned(labels)[0], labels)


def test_places_of_every_fitting_region_stay_out_of_irrelevant_pairs(two, monkeypatch):
    manifest, _ = two
    seen = []

    def remember(queries, database, query_positions, database_positions, threshold, **options):
        seen.append((query_positions, database_positions))
        return evaluate(queries, database, query_positions, database_positions, threshold, **options)

    monkeypatch.setattr("artifact.studies.composition.evaluate", remember)
    names = ["made", "other"]
    places = studies.composition.fitted_places(manifest, names, "made", 0.1)
    assert len(places) == 1  # the other dataset has coordinates of its own
    studies.composition.irrelevant_conditions(manifest, names, [synthetic.METHOD], iterations=2)
    fitted_there, threshold = places[0]
    for positions in seen[0]:
        away = np.linalg.norm(positions[:, None] - fitted_there[None], axis=2)
        assert (away > threshold).all()


def test_two_stage_methods_take_no_part_in_suppression(two):
    manifest, _ = two
    two_stage = manifest.methods[synthetic.METHOD].model_copy(update={"rerank": 100})
    both = dataclasses.replace(manifest, methods={**manifest.methods, "reranked": two_stage})
    methods = [synthetic.METHOD, "reranked"]
    table = studies.suppression.suppression_table(both, ["made"], methods, iterations=2).table
    assert set(table["method"]) == {synthetic.METHOD}
    table = studies.composition.single_against_multi(both, ["made", "other"], methods, iterations=2).table
    assert set(table["method"]) == {synthetic.METHOD}


def test_keys_of_fits_hold_the_library_that_decides_them(made, monkeypatch):
    _, one = made
    first = fitted.key_of("x", [one], [0.1])
    assert first == fitted.key_of("x", [one], [0.1])
    assert first != fitted.key_of("x", [one], [0.2])
    monkeypatch.setattr(fitted, "version", lambda name: "another")
    assert first != fitted.key_of("x", [one], [0.1])


def test_too_few_queries_to_fit_on_are_said_and_not_fitted(tmp_path, monkeypatch):
    one, measures = brightness_described(0.0, n=12)
    synthetic.offer(monkeypatch, one)
    monkeypatch.setattr(within_session, "appearance", lambda *_: measures)
    with pytest.raises(NothingToShowError, match="a dataset with 4 queries in 25 % of them"):
        studies.within_session.within_session(synthetic.manifest(tmp_path, one), ["made"], [synthetic.METHOD])
