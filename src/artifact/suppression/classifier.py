"""The linear classifier of INLP.

It is the one that scikit-learn 1.8 fits as ``SGDClassifier(max_iter=2500, class_weight="balanced", random_state=seed)``, to
the last bit, for dense rows and twice as fast: stochastic gradient descent on the hinge loss with the penalty
``alpha |w|² / 2``, ``alpha = 10⁻⁴``, one row after the other in an order that changes with each epoch, in steps of
``1 / (alpha (t₀ + t))`` (Bottou 2012, *Stochastic gradient descent tricks*). It ends once the mean objective of five epochs
in a row has not been lower by ``10⁻³`` than the lowest before.

Every bit counts here: late classifiers find the same conditions in what is left, and rounding decides which of many
directions. So sums are taken one by one, as scikit-learn does; that is slow because each addition waits for the one before.
The time is won by adding for several purposes at once: a row is added to the weights while these are multiplied with the
next, and as long as nothing is added they are multiplied with four.
"""

from __future__ import annotations

import numpy as np

from artifact.suppression.compiled import compiled

EPOCHS = 2500
_ALPHA, _LEAST_GAIN, _PATIENCE = 1e-4, 1e-3, 5
_FIRST = 1 / (np.sqrt(1 / np.sqrt(_ALPHA)) * _ALPHA)  # t₀: the first step is as long as weights typically are
_SMALLEST_SCALE = 1e-9
_AHEAD = 4  # rows
_LARGEST_INT = 2**31 - 1


class LinearClassifier:
    """One hinge classifier for two conditions, one against the rest for each of more; all conditions weigh the same.

    Attributes
    ----------
    classes_
        The conditions, sorted.
    coef_, intercept_
        ``(1, d)`` and ``(1,)`` for two conditions, whose second is the positive one, else a row for each.
    n_iter_
        Epochs until it ended, the most of all; :data:`EPOCHS` if it had not converged.
    """

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def fit(self, X: np.ndarray, condition: np.ndarray) -> LinearClassifier:
        """Fit on rows ``(n, d)`` float64 and their conditions; raises ``ValueError`` if numbers overflow."""
        self.classes_, number, count = np.unique(condition, return_inverse=True, return_counts=True)
        weights, generator = len(X) / (len(count) * count), np.random.RandomState(self.seed)
        if len(count) == 2:
            turns = [(1, weights[0], _drawn(generator))]
        else:
            seeds = generator.randint(_LARGEST_INT, size=len(count))
            turns = [(one, 1.0, _drawn(np.random.RandomState(seed))) for one, seed in enumerate(seeds)]
        X = np.ascontiguousarray(X, np.float64)
        found = [
            _descend(X, np.where(number == one, 1.0, -1.0), weights[one], rest, seed, EPOCHS)
            for one, rest, seed in turns
        ]
        self.coef_ = np.stack([coefficients for coefficients, _, _ in found])
        self.intercept_ = np.array([intercept for _, intercept, _ in found])
        self.n_iter_ = max(epochs for _, _, epochs in found)
        if not (np.isfinite(self.coef_).all() and np.isfinite(self.intercept_).all()):
            raise ValueError("descriptors are so large that a classifier's weights overflow; scale them to unit length")
        return self

    def predict(self, X: np.ndarray) -> np.ndarray:
        """Return the condition of rows ``(n, d)``."""
        scores = X @ self.coef_.T + self.intercept_
        return self.classes_[(scores[:, 0] > 0).astype(int) if scores.shape[1] == 1 else scores.argmax(axis=1)]


def _drawn(generator: np.random.RandomState) -> int:
    """Return the seed of the orders: scikit-learn's second draw, after one for a data set that needs none."""
    generator.randint(1, _LARGEST_INT)
    return int(generator.randint(_LARGEST_INT))


@compiled()
def _products(weights: np.ndarray, X: np.ndarray, rows: np.ndarray, out: np.ndarray) -> None:
    """Write the products of the weights and of four rows."""
    p, q, r, s = X[rows[0]], X[rows[1]], X[rows[2]], X[rows[3]]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for column in range(weights.size):
        weight = weights[column]
        a += weight * p[column]
        b += weight * q[column]
        c += weight * r[column]
        d += weight * s[column]
    out[0], out[1], out[2], out[3] = a, b, c, d


@compiled()
def _add(weights: np.ndarray, row: np.ndarray, times: float, following: np.ndarray) -> tuple[float, float]:
    """Add a multiple of a row to the weights; return their squared length and their product with the row that follows."""
    squared, product = 0.0, 0.0
    for column in range(weights.size):
        weight = weights[column] + row[column] * times
        weights[column] = weight
        squared += weight * weight
        product += weight * following[column]
    return squared, product


@compiled()
def _shuffle(order: np.ndarray, seed: int) -> None:
    """Shuffle in place by Marsaglia's 32-bit Xorshift (2003, *Xorshift RNGs*), beginning anew with the seed."""
    state = np.uint32(max(seed, 1))
    for place in range(order.size - 1):
        state ^= np.uint32(state << np.uint32(13))
        state ^= np.uint32(state >> np.uint32(17))
        state ^= np.uint32(state << np.uint32(5))
        other = place + np.int64(state & np.uint32(_LARGEST_INT)) % (order.size - place)
        order[place], order[other] = order[other], order[place]


@compiled()
def _descend(
    X: np.ndarray, side: np.ndarray, own_weight: float, other_weight: float, seed: int, epochs: int
) -> tuple[np.ndarray, float, int]:
    """Return weights, intercept and the number of epochs, for rows on the sides 1 and -1."""
    n, d = X.shape
    # The weights are scale * weights: so a penalty shrinks them all by one multiplication.
    weights, scale, squared, intercept = np.zeros(d), 1.0, 0.0, 0.0
    order, step, lowest, waited = np.empty(n + _AHEAD, np.int64), 0, np.inf, 0
    order[:n] = np.arange(n)
    products = np.empty(_AHEAD)
    for epoch in range(epochs):
        _shuffle(order[:n], seed)
        order[n:] = order[n - 1]
        objective, known = 0.0, 0
        for turn in range(n):
            if known == 0:
                _products(weights, X, order[turn:], products)
                known = _AHEAD
            row, product = order[turn], products[_AHEAD - known]
            known -= 1
            margin = (product * scale + intercept) * side[row]
            rate = 1 / (_ALPHA * (_FIRST + step))
            step += 1
            objective += 1 - margin if margin <= 1 else 0.0
            objective += _ALPHA * (0.5 * np.sqrt(squared) ** 2)
            shrink = max(0.0, 1 - rate * _ALPHA)
            scale, squared = scale * shrink, squared * (shrink * shrink)
            if scale < _SMALLEST_SCALE:
                weights *= scale
                scale, known = 1.0, 0
            if margin <= 1:
                change = rate * side[row] * (own_weight if side[row] > 0 else other_weight)
                squared, products[-1] = _add(weights, X[row], change / scale, X[order[turn + 1]])
                squared, known = squared * (scale * scale), 1
                intercept += change
        if not (np.isfinite(intercept) and np.isfinite(squared)):
            return weights, np.nan, epoch + 1
        waited = waited + 1 if objective / n > lowest - _LEAST_GAIN else 0
        lowest = min(lowest, objective / n)
        if waited == _PATIENCE:
            return weights * scale, intercept, epoch + 1
    return weights * scale, intercept, epochs
