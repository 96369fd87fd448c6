"""INLP, LEACE and STD: the mathematics that they promise, and the errors that they give."""

import functools
import importlib
import pickle
import platform
import warnings

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning, NotFittedError
from sklearn.linear_model import LogisticRegression, SGDClassifier
from sklearn.metrics import balanced_accuracy_score

from artifact import INLP, LEACE, STD, compose, evaluate, load_transform
from artifact.suppression import classifier, inlp
from artifact.suppression.inlp import _coordinates, _erased_directions
from artifact.suppression.lowrank import LowRankMap

with warnings.catch_warnings():  # the package uses parts of torch that are deprecated
    warnings.simplefilter("ignore", DeprecationWarning)
    from concept_erasure import LeaceFitter

SHAPES = [(300, 20, 2), (60, 200, 2), (400, 30, 5), (90, 300, 10), (30, 30, 3)]


def labelled(n, d, conditions, seed=0, shift=0.8):
    """Descriptors whose mean depends on the condition, with correlated columns and a mean far from zero."""
    rng = np.random.default_rng(seed)
    condition = rng.permutation(np.arange(n) % conditions)
    mixing = rng.standard_normal((d, d)) / np.sqrt(d) + np.eye(d)
    X = rng.standard_normal((n, d)) @ mixing + shift * rng.standard_normal((conditions, d))[condition] + 0.3
    return X, condition


def one_hot(condition):
    return (condition[:, None] == np.unique(condition)).astype(float)


def class_means(X, condition):
    return np.stack([X[condition == c].mean(axis=0) for c in np.unique(condition)])


def whitening_leace(X, condition, shrinkage):
    """The paper's formula, dense and in float64: x - W^+ P_{W S_xz} W (x - E[X])."""
    n, d = X.shape
    centred, labels = X - X.mean(axis=0), one_hot(condition) - one_hot(condition).mean(axis=0)
    covariance = centred.T @ centred / n
    if shrinkage:
        trace = np.trace(covariance)
        alpha = 1 - (trace**2 / n) / ((covariance**2).sum() - trace**2 / d)
        assert 0 < alpha < 1, "the reference does not clip; choose data where it need not"
        covariance = alpha * covariance + (1 - alpha) * trace / d * np.eye(d)
    values, vectors = np.linalg.eigh(covariance)
    kept = values > values[-1] * max(n, d) * np.finfo(float).eps
    values, vectors = values[kept], vectors[:, kept]
    whiten, colour = (vectors / np.sqrt(values)) @ vectors.T, (vectors * np.sqrt(values)) @ vectors.T
    whitened = whiten @ centred.T @ labels / n
    projection = whitened @ np.linalg.pinv(whitened, rcond=1e-9)
    return X - centred @ (colour @ projection @ whiten).T


# -- LEACE ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shrinkage", [False, True])
@pytest.mark.parametrize(("n", "d", "conditions"), SHAPES)
def test_leace_equals_the_whitening_formula(n, d, conditions, shrinkage):
    X, condition = labelled(n, d, conditions)
    erased = LEACE(shrinkage=shrinkage).fit(X, condition).transform(X)
    expected = whitening_leace(X, condition, shrinkage)
    np.testing.assert_allclose(erased, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize(("n", "d", "conditions"), SHAPES)
def test_leace_equals_the_reference_package_on_its_defaults(n, d, conditions):
    X, condition = labelled(n, d, conditions, shift=1.5)
    eraser = LeaceFitter.fit(torch.from_numpy(X), torch.from_numpy(one_hot(condition))).eraser
    expected = eraser(torch.from_numpy(X)).numpy()
    np.testing.assert_allclose(
        LEACE(shrinkage=True).fit(X, condition).transform(X), expected, atol=1e-8 * np.abs(X).max()
    )


@pytest.mark.parametrize(("n", "d", "conditions"), SHAPES)
def test_leace_makes_class_means_equal_keeps_the_mean_and_changes_a_low_rank(n, d, conditions):
    X, condition = labelled(n, d, conditions)
    fitted = LEACE().fit(X, condition)
    erased = fitted.transform(X)
    before, after = class_means(X, condition), class_means(erased, condition)
    assert np.ptp(before, axis=0).max() > 0.1
    np.testing.assert_allclose(np.ptp(after, axis=0), 0, atol=1e-8)
    np.testing.assert_allclose(erased.mean(axis=0), X.mean(axis=0), atol=1e-9)
    assert np.linalg.matrix_rank(X - erased, tol=1e-7) == fitted.map_.rank == conditions - 1
    np.testing.assert_allclose(fitted.transform(erased), erased, atol=1e-8)  # idempotent
    assert fitted.map_.left.shape == (d, conditions - 1)


@pytest.mark.parametrize("eraser", [LEACE(), STD()])
def test_no_linear_classifier_learns_the_condition_after_erasure(eraser):
    """Linear guardedness (paper Eq. 2): the best unregularised classifier has zero coefficients."""
    X, condition = labelled(400, 12, 2)
    before = LogisticRegression(C=1e12, tol=1e-12, max_iter=5000).fit(X, condition)
    assert np.abs(before.coef_).max() > 0.1
    fitted = eraser.fit(X, condition)
    erased = fitted.transform(X, condition) if isinstance(eraser, STD) else fitted.transform(X)
    after = LogisticRegression(C=1e12, tol=1e-12, max_iter=5000).fit(erased - erased.mean(axis=0), condition)
    assert np.abs(after.coef_).max() < 1e-6


def test_leace_is_the_smallest_change_among_guarding_maps():
    """First-order optimality: moving the map within the guarding affine maps does not lower the mean squared change."""
    X, condition = labelled(200, 6, 2)
    mean, cross = X.mean(axis=0), (X - X.mean(axis=0)).T @ (condition - condition.mean())
    erased = LEACE().fit(X, condition).transform(X)
    smallest = ((erased - X) ** 2).sum()

    def change(free):
        # every linear map that guards sends the cross-covariance to zero: A = F (I - c c' / c'c)
        matrix = free.reshape(6, 6) @ (np.eye(6) - np.outer(cross, cross) / (cross @ cross))
        return (((X - mean) @ matrix.T + mean - X) ** 2).sum()

    best = minimize(
        change, np.eye(6).ravel(), method="L-BFGS-B", options={"maxiter": 2000, "ftol": 1e-15, "gtol": 1e-9}
    )
    assert smallest == pytest.approx(best.fun, rel=1e-5)
    assert smallest < change(np.eye(6).ravel()) * 0.999, "an orthogonal projection is a larger change"


@pytest.mark.parametrize("shrinkage", [False, True])
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize(("n", "d", "conditions"), [*SHAPES, (500, 64, 2), (200, 2000, 2)])
def test_leace_fitted_on_its_own_output_changes_nothing(n, d, conditions, kind, shrinkage):
    for seed in range(3):
        X, condition = labelled(n, d, conditions, seed)
        X = X.astype(kind)
        erased = LEACE(shrinkage).fit(X, condition).transform(X).astype(kind)
        refitted = LEACE(shrinkage).fit(erased, condition)
        change = np.abs(refitted.transform(erased).astype(float) - erased.astype(float)).max()
        assert change <= 4 * np.finfo(kind).eps * np.abs(X.astype(float)).max()
    # Held in a wider type, the values are still those of the narrow one.
    again = LEACE(shrinkage).fit(erased.astype(np.float64), condition)
    np.testing.assert_array_equal(again.transform(erased.astype(np.float64)), erased)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(("n", "d"), [(2000, 64), (150, 400)])
def test_leace_removes_a_weak_condition_beside_a_strong_one(n, d, kind):
    """Means that differ by a thousandth of the scatter are far above rounding, with fewer columns than rows and with more."""
    X, condition = labelled(n, d, 3)
    X -= class_means(X, condition)[condition]
    scatter = np.sqrt((X**2).sum(axis=1).mean())
    directions = np.linalg.qr(np.random.default_rng(1).standard_normal((d, 2)))[0].T
    X += scatter * np.stack([directions[0], -directions[0], 1e-3 * directions[1]])[condition]
    fitted = LEACE().fit(X.astype(kind), condition)
    assert fitted.map_.rank == 2
    means = class_means(fitted.transform(X.astype(kind)).astype(float), condition)
    assert np.ptp(means, axis=0).max() < 1e-5 * scatter


def test_leace_guards_every_condition_however_differently_the_directions_scatter():
    """Two conditions differ along one direction each, of scatters 1 and 1,000: both are erased, whatever the units."""
    rng, condition = np.random.default_rng(3), np.arange(600) % 3
    scatter = np.ones(12)
    scatter[1] = 1000.0
    X = rng.standard_normal((600, 12)) * scatter
    X[:, 0] += 2.0 * (condition == 1)
    X[:, 1] += 2000.0 * (condition == 2)
    fitted = LEACE().fit(X, condition)
    assert fitted.map_.rank == 2
    np.testing.assert_allclose(np.ptp(class_means(fitted.transform(X), condition), axis=0) / scatter, 0, atol=1e-9)


def test_leace_tolerance_drops_directions_without_data():
    X, condition = labelled(100, 8, 2)
    X = np.concatenate([X, X[:, :2] + 1e-13], axis=1)  # two columns repeat: the covariance is singular
    erased = LEACE().fit(X, condition).transform(X)
    np.testing.assert_allclose(erased[:, 8:], erased[:, :2], atol=1e-7)
    np.testing.assert_allclose(np.ptp(class_means(erased, condition), axis=0), 0, atol=1e-8)


# -- INLP -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "d", "conditions"), [(400, 60, 2), (90, 300, 2), (120, 200, 3)])
def test_inlp_is_an_orthogonal_projection_of_its_rank(n, d, conditions):
    X, condition = labelled(n, d, conditions)
    fitted = INLP(n_iterations=35 if conditions == 2 else 5).fit(X, condition)
    directions = fitted.directions_
    k = 35 if conditions == 2 else 15
    assert directions.shape == (d, k)
    np.testing.assert_allclose(directions.T @ directions, np.eye(k), atol=1e-12)
    projected = fitted.transform(X)
    np.testing.assert_allclose(fitted.transform(projected), projected, atol=1e-10)
    assert np.linalg.matrix_rank(X - projected, tol=1e-8) == k
    np.testing.assert_allclose(projected @ directions, 0, atol=1e-10)
    assert len(fitted.accuracies_) == len(fitted.ends_)


def test_inlp_lowers_what_its_classifiers_find():
    X, condition = labelled(500, 40, 2, shift=0.5)
    fitted = INLP(n_iterations=12).fit(X, condition)
    assert fitted.accuracies_[0] > 0.95
    assert fitted.accuracies_[-1] < 0.65
    gaps = [np.linalg.norm(np.subtract(*class_means(fitted.at(i).transform(X), condition))) for i in range(13)]
    assert gaps[-1] < 0.3 * gaps[0]


@pytest.mark.filterwarnings("ignore:Maximum number of iteration")  # one of them does not converge
@pytest.mark.parametrize("n_conditions", [2, 3, 5])
@pytest.mark.parametrize(("n", "d", "shift"), [(300, 30, 0.3), (90, 700, 0.1), (60, 4, 0.0)])
def test_the_classifier_is_the_one_of_scikit_learn(n, d, shift, n_conditions):
    """Weights, epochs and what it predicts, for separable and other rows, many of one condition and few of another."""
    X, condition = labelled(n, d, n_conditions, shift=shift)
    condition[: n // 2] = 0
    names = np.array(["rain", "night", "snow", "dawn", "dusk"])[condition]
    for seed, scale in ((0, 1.0), (7, 0.03), (2**31 - 1, 20.0)):
        expected = SGDClassifier(max_iter=2500, class_weight="balanced", random_state=seed).fit(scale * X, names)
        found = classifier.LinearClassifier(seed).fit(scale * X, names)
        assert found.n_iter_ == expected.n_iter_
        for attribute in ("coef_", "intercept_"):
            ours, theirs = getattr(found, attribute), getattr(expected, attribute)
            if platform.machine() == "x86_64":
                np.testing.assert_array_equal(ours, theirs, strict=True)
            else:  # scikit-learn may have been compiled to round a multiplication and an addition once
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10 * np.abs(theirs).max(), strict=True)
        np.testing.assert_array_equal(found.predict(scale * X), expected.predict(scale * X))


def test_a_classifier_that_overflows_says_so():
    X, condition = labelled(40, 5, 2)
    with pytest.raises(ValueError, match="descriptors are so large that a classifier's weights overflow; scale them"):
        classifier.LinearClassifier().fit(X * 1e200, condition)


def direct_inlp(X, condition, iterations, seed=0):
    """The loop on the descriptors themselves, with rank-1 deflation."""
    X, directions, accuracies = X.copy(), [], []
    for _ in range(iterations):
        classifier = SGDClassifier(max_iter=2500, class_weight="balanced", random_state=seed).fit(X, condition)
        accuracies.append(balanced_accuracy_score(condition, classifier.predict(X)))
        direction = classifier.coef_[0] / np.linalg.norm(classifier.coef_[0])
        directions.append(direction)
        X = X - np.outer(X @ direction, direction)
    return np.array(directions).T, np.array(accuracies)


@pytest.mark.parametrize(("n", "d"), [(300, 50), (150, 2000)])
def test_inlp_in_sample_space_equals_the_direct_loop(n, d):
    X, condition = labelled(n, d, 2, shift=0.15)
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    fitted = INLP(n_iterations=6).fit(X.astype(np.float32), condition)
    directions, accuracies = direct_inlp(X, condition, 6)
    cosines = np.abs((fitted.directions_ * directions).sum(axis=0))
    assert (cosines[:3] > 0.999).all()
    np.testing.assert_allclose(fitted.accuracies_[:3], accuracies[:3], atol=0.02)


def test_of_few_images_the_seed_decides_which_directions_go():
    """With 44 images the first classifier tells the conditions apart, late ones do not, and theirs are other directions."""
    X, condition = labelled(44, 300, 2)
    one, other = (INLP(n_iterations=35, seed=seed).fit(X, condition) for seed in (0, 1))
    for fitted in (one, other):
        assert fitted.accuracies_[0] == 1.0
        assert (np.abs(fitted.accuracies_[10:] - 0.5) < 0.15).all()
    shared = np.linalg.svd(one.directions_[:, 10:].T @ other.directions_[:, 10:], compute_uv=False)
    assert (shared**2).mean() < 0.8


def test_inlp_balances_conditions_of_unequal_size():
    """With nine times as many images of one condition: the classifiers of the definition, and their balanced accuracy."""
    X, condition = labelled(300, 20, 10, shift=0.3)
    condition = (condition == 0).astype(int)
    fitted = INLP(n_iterations=3).fit(X, condition)
    directions, accuracies = direct_inlp(X, condition, 3)
    assert ((fitted.directions_ * directions).sum(axis=0) > 0.999).all(), "they point where the classifiers' do"
    np.testing.assert_allclose(fitted.accuracies_, accuracies, atol=1e-9)
    plain = SGDClassifier(max_iter=2500, class_weight="balanced", random_state=0).fit(X, condition).score(X, condition)
    assert abs(plain - accuracies[0]) > 1e-3, "the two accuracies are told apart"


class Given:
    """In the place of a classifier: it finds directions that are given in advance."""

    n_iter_ = 1

    def __init__(self, weights, _):
        self.weights = weights

    def fit(self, X, condition):
        self.coef_ = next(self.weights)[None]
        return self

    def predict(self, X):
        return np.zeros(len(X), int)


def test_a_direction_close_to_the_earlier_ones_leaves_nothing_of_any(monkeypatch):
    """Whatever classifiers find, the directions are orthogonal to the last digit and their part of the data is gone."""
    rng = np.random.default_rng(0)
    first, second, third = rng.standard_normal((3, 40))
    weights = [first, first + 1e-8 * second, first - second + 1e-8 * third]
    monkeypatch.setattr("artifact.suppression.inlp.LinearClassifier", functools.partial(Given, iter(weights)))
    coordinates = rng.standard_normal((90, 40))
    basis, _, ends = _erased_directions(coordinates, np.arange(90) % 2, 3, 0)
    assert ends.tolist() == [1, 2, 3]
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(coordinates @ basis, 0, atol=1e-13)
    for found in weights:
        np.testing.assert_allclose(basis @ (basis.T @ found), found, atol=1e-13)


def test_directions_are_orthonormal_where_the_data_are_nearly_flat(monkeypatch):
    """Fewer rows than columns, and scatters from 1 down to a millionth: the way back to descriptors is rounded."""
    rng = np.random.default_rng(0)
    rows, axes = (np.linalg.qr(rng.standard_normal(shape))[0] for shape in ((30, 30), (200, 30)))
    X = (rows * np.logspace(0, -5.9, 30)) @ axes.T
    # Each classifier finds one axis of the coordinates, those of the least scatter first.
    monkeypatch.setattr("artifact.suppression.inlp.LinearClassifier", functools.partial(Given, iter(np.eye(30))))
    fitted = INLP(n_iterations=12).fit(X, np.arange(30) % 2)
    directions = fitted.directions_
    np.testing.assert_allclose(directions.T @ directions, np.eye(12), atol=1e-13)
    for step in range(13):
        once = fitted.at(step).transform(X)
        np.testing.assert_allclose(fitted.at(step).transform(once), once, atol=1e-13)


def test_coordinates_keep_every_inner_product():
    X, _ = labelled(40, 500, 2)
    coordinates, lift = _coordinates(X, None)
    assert coordinates.shape == (40, 40)
    np.testing.assert_allclose(coordinates @ coordinates.T, X @ X.T, atol=1e-9 * np.abs(X @ X.T).max())
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((40, 3)))[0]
    np.testing.assert_allclose(X @ lift(basis), coordinates @ basis, atol=1e-9)


def test_rows_that_repeat_add_no_coordinates():
    X, condition = labelled(20, 50, 2)
    twice = np.concatenate([X, X])
    coordinates, lift = _coordinates(twice, None)
    assert coordinates.shape == (40, 20)
    np.testing.assert_allclose(lift(np.eye(20)).T @ lift(np.eye(20)), np.eye(20), atol=1e-6)
    directions = INLP(3).fit(twice, np.tile(condition, 2)).directions_
    assert np.isfinite(directions).all()


def test_inlp_can_be_read_at_every_iteration():
    X, condition = labelled(200, 30, 2)
    fitted = INLP(n_iterations=5).fit(X, condition)
    np.testing.assert_array_equal(fitted.at(0).transform(X), X)
    np.testing.assert_allclose(fitted.at(5).transform(X), fitted.transform(X))
    again = INLP(n_iterations=3).fit(X, condition)
    np.testing.assert_allclose(fitted.at(3).transform(X), again.transform(X), atol=1e-10)
    with pytest.raises(ValueError, match="iteration is 6; allowed: 0 to 5"):
        fitted.at(6)


def test_inlp_stops_when_nothing_is_left():
    X, condition = labelled(12, 40, 2)
    fitted = INLP(n_iterations=35).fit(X, condition)
    assert fitted.directions_.shape[1] <= 12
    assert len(fitted.ends_) < 35
    np.testing.assert_allclose(fitted.transform(X), 0, atol=1e-8)


def test_the_same_seed_gives_the_same_directions():
    X, condition = labelled(80, 200, 2)
    first, second = (INLP(n_iterations=4, seed=3).fit(X, condition).directions_ for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_classifiers_that_do_not_converge_are_counted_once(monkeypatch):
    monkeypatch.setattr(classifier, "EPOCHS", 1)
    monkeypatch.setattr(inlp, "EPOCHS", 1)
    X, condition = labelled(60, 20, 2)
    with pytest.warns(ConvergenceWarning, match="3 of 3 INLP classifiers did not converge") as caught:
        INLP(n_iterations=3).fit(X, condition)
    assert len(caught) == 1


# -- STD ------------------------------------------------------------------------------------------------------------


def test_std_gives_every_condition_mean_0_and_deviation_1():
    X, condition = labelled(200, 15, 3)
    X[:, 4] = np.where(condition == 1, 5.0, X[:, 4])  # constant under one condition
    out = STD().fit(X, condition).transform(X, condition)
    for c in range(3):
        np.testing.assert_allclose(out[condition == c].mean(axis=0), 0, atol=1e-9)
        expected = np.where((np.arange(15) == 4) & (c == 1), 0, 1)
        np.testing.assert_allclose(out[condition == c].std(axis=0), expected, atol=1e-9)


def test_std_judges_flat_columns_by_the_scatter_of_their_own_condition():
    """Descriptors of one condition may scatter a million times less than those of the other: that is no flat column."""
    X, condition = labelled(200, 15, 2)
    X[condition == 1] *= 1e-7
    out = STD().fit(X, condition).transform(X, condition)
    for c in range(2):
        np.testing.assert_allclose(out[condition == c].mean(axis=0), 0, atol=1e-9)
        np.testing.assert_allclose(out[condition == c].std(axis=0), 1, atol=1e-9)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_std_in_blocks_and_in_place_gives_the_same(kind, monkeypatch):
    X, condition = labelled(60, 7, 2)
    X = X.astype(kind)
    fitted = STD().fit(X, condition)
    whole, given = fitted.transform(X, condition), X.copy()
    monkeypatch.setattr("artifact.suppression.std._BLOCK", 4 * 7)
    np.testing.assert_array_equal(fitted.transform(given, condition), whole)
    np.testing.assert_array_equal(given, X)
    out = fitted.transform(given, condition, copy=False)
    np.testing.assert_array_equal(out, whole)
    assert (out is given) == (kind != np.float16)


def test_std_takes_one_condition_for_all_rows_and_refuses_unseen_ones():
    X, condition = labelled(60, 5, 2)
    fitted = STD().fit(X, condition)
    np.testing.assert_array_equal(fitted.transform(X, 1), fitted.transform(X, np.ones(60, int)))
    with pytest.raises(ValueError, match=r"condition 7 was not seen at fit; the conditions are \[0, 1\]"):
        fitted.transform(X, 7)


# -- composition and storage ----------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from(["inlp", "leace", "shrunk"]), min_size=1, max_size=4), st.integers(0, 1000))
def test_composition_equals_applying_in_order(kinds, seed):
    steps, current = [], labelled(50, 24, 2, seed)[0]
    X = current
    for number, kind in enumerate(kinds):
        condition = np.random.default_rng([seed, number]).permutation(np.arange(50) % 2)
        step = {"inlp": INLP(n_iterations=3), "leace": LEACE(), "shrunk": LEACE(shrinkage=True)}[kind].fit(
            current, condition
        )
        steps.append(step)
        current = step.transform(current)
    both = compose(*steps)
    assert both.rank == sum(step.low_rank()[0].shape[1] for step in steps)
    np.testing.assert_allclose(both.transform(X), current, atol=1e-8 * np.abs(X).max())
    np.testing.assert_allclose(
        compose(compose(*steps[:1]), *steps[1:]).transform(X), current, atol=1e-8 * np.abs(X).max()
    )


def test_what_cannot_be_composed():
    X, condition = labelled(60, 5, 2)
    with pytest.raises(TypeError, match="STD has no low-rank form"):
        compose(LEACE().fit(X, condition), STD().fit(X, condition))
    with pytest.raises(ValueError, match="different widths: 4, 5"):
        compose(LEACE().fit(X, condition), LEACE().fit(X[:, :4], condition))
    with pytest.raises(ValueError, match="at least one transform"):
        compose()


def test_saved_transforms_give_the_same(tmp_path):
    X, condition = labelled(60, 9, 2)
    leace, inlp, std = LEACE().fit(X, condition), INLP(2).fit(X, condition), STD().fit(X, condition)
    compose(leace, inlp).save(tmp_path / "both.npz")
    loaded = load_transform(tmp_path / "both.npz")
    np.testing.assert_array_equal(loaded.transform(X), compose(leace, inlp).transform(X))
    assert compose(loaded, leace).rank == 4
    std.save(str(tmp_path / "std"))  # any name
    np.testing.assert_array_equal(load_transform(tmp_path / "std").transform(X, condition), std.transform(X, condition))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["both.npz", "std"]


def test_a_transform_that_is_not_written_whole_leaves_the_old_one(tmp_path, monkeypatch):
    X, condition = labelled(60, 9, 2)
    saved = compose(LEACE().fit(X, condition))
    saved.save(tmp_path / "a.npz")
    before = (tmp_path / "a.npz").read_bytes()

    def full(stream, **_):
        stream.write(b"half")
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space"):
        compose(saved, saved).save(tmp_path / "a.npz")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [before]


def test_files_that_are_no_transforms_are_refused_in_one_line(tmp_path):
    path, good = tmp_path / "x.npz", {"left": np.ones((3, 1)), "right": np.ones((3, 1)), "offset": np.ones(1)}
    form = {"format": np.array("artifact transform 1, low-rank map")}

    class Evil:
        def __reduce__(self):
            return (pytest.fail, ("the file was run",))

    def arrays(**named):
        np.savez(path, **named)

    def pickled():
        path.write_bytes(pickle.dumps(Evil()))

    for write in (
        lambda: path.write_bytes(b""),
        lambda: path.write_text("left,right"),
        lambda: path.write_bytes(b"PK\x03\x04 cut off"),
        lambda: (np.save(tmp_path / "y.npy", np.eye(3)), (tmp_path / "y.npy").replace(path)),
        pickled,
        lambda: arrays(**good, **form | {"format": np.array([Evil()], object)}),
        lambda: arrays(**good),
        lambda: arrays(**good, format=np.array("other")),
        lambda: arrays(**form, **good | {"right": np.ones((4, 1))}),
        lambda: arrays(**form, **good | {"offset": np.ones(2)}),
        lambda: arrays(**form, **good | {"left": np.full((3, 1), np.nan)}),
        lambda: arrays(**form, left=good["left"]),
    ):
        write()
        with pytest.raises(ValueError, match=r"x\.npz: not a saved transform \(.*allowed: files written by") as caught:
            load_transform(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError):
        load_transform(tmp_path / "none.npz")


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_transforms_keep_the_dtype(kind):
    X, condition = labelled(60, 9, 2)
    X = X.astype(kind)
    assert LEACE().fit(X, condition).transform(X).dtype == kind
    assert INLP(n_iterations=2).fit(X, condition).transform(X).dtype == kind
    assert STD().fit(X, condition).transform(X, condition).dtype == kind


# -- views in the ranking pass --------------------------------------------------------------------------------------


@pytest.mark.parametrize("similarity", ["cosine", "l2", "dot"])
@pytest.mark.parametrize("device", ["cpu", "torch"])
def test_views_equal_transforming_the_descriptors_first(similarity, device, monkeypatch):
    if device == "torch":
        from artifact.ranking import one_pass
        from artifact.ranking.engine_torch import TorchEngine

        monkeypatch.setattr(one_pass, "engine_for", lambda _: TorchEngine(torch.device("cpu")))
    rng = np.random.default_rng(0)
    n, d = 120, 40
    places = rng.standard_normal((n, d))
    bias = rng.standard_normal((2, d))
    queries, database = ((places + 0.4 * rng.standard_normal((n, d)) + b).astype(np.float32) for b in bias)
    queries, database = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (queries, database))
    where = np.arange(n, dtype=float)
    X, condition = np.concatenate([queries, database]), np.repeat([0, 1], n)
    inlp, leace = INLP(n_iterations=6).fit(X, condition), LEACE().fit(X, condition)
    views = {"inlp at 2": inlp.at(2), "inlp at 3": inlp.at(3), "inlp": inlp, "again": inlp, "inlp at 1": inlp.at(1)}
    views |= {"leace": leace, "both": compose(leace, inlp)}
    result = evaluate(queries, database, where, where, 1.0, views=views, similarity=similarity, retrieve=5)
    unchanged = evaluate(queries, database, where, where, 1.0, views={"none": inlp.at(0)}, similarity=similarity)
    np.testing.assert_array_equal(unchanged["none"].ranks(distractors=True), result.ranks(distractors=True))
    bare = evaluate(queries, database, where, where, 1.0, views=views, similarity=similarity)
    swept = evaluate(queries, database, where, where, 1.0, views=views, similarity=similarity, view_sweeps=True)
    for name, view in views.items():
        q, c = (view.transform(x) for x in (queries, database))
        alone = _without_unit_length_check(monkeypatch, q, c, where, similarity)
        seen = result[name]
        np.testing.assert_allclose(seen.per_query()["similarity"], alone.per_query()["similarity"], atol=1e-5)
        np.testing.assert_array_equal(seen.ranks(distractors=False), alone.ranks(distractors=False))
        np.testing.assert_array_equal(seen.ranks(distractors=True), alone.ranks(distractors=True))
        np.testing.assert_array_equal(seen.retrieved(5, distractors=True)[0], alone.retrieved(5, distractors=True)[0])
        np.testing.assert_array_equal(bare[name].ranks(distractors=True), alone.ranks(distractors=True))
        np.testing.assert_array_equal(bare[name].distractor_counts.ties, alone.distractor_counts.ties)
        np.testing.assert_allclose(swept[name].dar_by_distance([1, 5, np.inf]), alone.dar_by_distance([1, 5, np.inf]))
        np.testing.assert_allclose(swept[name].dar_by_ratio_draws([0.3]), alone.dar_by_ratio_draws([0.3]))
        with pytest.raises(ValueError, match="pass view_sweeps=True"):
            bare[name].dar_by_distance([1, 5])
    assert bare.dar_by_distance([1.0]) == pytest.approx(bare.dar())
    assert result["leace"].dar() > result.dar() + 0.2


def _without_unit_length_check(monkeypatch, q, c, where, similarity):
    """Transformed descriptors are not of unit length, which `l2` and `dot` ask of their inputs."""
    module = importlib.import_module("artifact.metrics.evaluate")
    with monkeypatch.context() as patch:
        patch.setattr(module, "_UNIT_TOLERANCE", np.inf)
        return evaluate(q, c, where, where, 1.0, similarity=similarity, retrieve=5)


# -- errors ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", [INLP(n_iterations=2), LEACE(), STD()])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda X, c: (X, np.zeros(len(c), int)), "all 20 descriptors have the condition 0; at least two conditions"),
        (
            lambda X, c: (X, np.where(np.arange(20) == 3, 9, 0)),
            "condition 9 has one descriptor; at least two are needed",
        ),
        (lambda X, c: (np.ones_like(X), c), "all 20 descriptors are the same"),
        (lambda X, c: (np.where(np.arange(20)[:, None] == 5, np.nan, X), c), "row 5 of the descriptors has NaN"),
        (lambda X, c: (X, c[:-1]), r"condition has the shape \(19,\); allowed: \(20,\)"),
        (lambda X, c: (X[0], c), r"descriptors have the shape \(6,\)"),
        (lambda X, c: (X.astype(int), c), "type int64; allowed: .* float type"),
    ],
)
def test_bad_fits_are_named(estimator, change, message):
    X, condition = labelled(20, 6, 2)
    with pytest.raises(ValueError, match=message):
        clone(estimator).fit(*change(X, condition))


def test_bad_transforms_are_named():
    X, condition = labelled(20, 6, 2)
    for estimator in (INLP(n_iterations=2), LEACE()):
        with pytest.raises(NotFittedError):
            estimator.transform(X)
        with pytest.raises(ValueError, match=r"shape \(20, 5\); this transform was fitted on \(n, 6\)"):
            estimator.fit(X, condition).transform(X[:, :5])
    with pytest.raises(ValueError, match=r"fitted on \(n, 6\)"):
        STD().fit(X, condition).transform(X[:, :5], 0)


def test_estimators_follow_scikit_learn():
    for estimator, parameters in (
        (INLP(7, seed=2), {"n_iterations": 7, "seed": 2, "device": None}),
        (LEACE(True), {"shrinkage": True, "tolerance": None, "device": None}),
        (STD(), {"epsilon": 1e-6}),
    ):
        assert estimator.get_params() == parameters
        assert clone(estimator).get_params() == parameters
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (
            LowRankMap(np.zeros((3, 0)), np.zeros((3, 0)), np.zeros(0)).transform(np.eye(3)).tolist()
            == np.eye(3).tolist()
        )
