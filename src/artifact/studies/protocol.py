"""Every choice that the paper leaves open, our default for it, and how much the cheap ones matter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.studies import evaluated
from artifact.studies.common import PERCENT, Study


@dataclass(frozen=True)
class Decision:
    """One choice: what it is about, what the paper says, what we do."""

    topic: str
    paper: str
    ours: str


DECISIONS = (
    Decision("Positive", "within the threshold", "distance ≤ threshold, inclusive; frame tolerance: index difference in the dataset's own list of images; exact match: equal pair index"),
    Decision("Excluded queries", "queries without a ground-truth match are excluded", "they leave numerator, denominator and the distractor pool; their number is printed"),
    Decision("Distractors of a query", "pool images outside the threshold", "distance > threshold, strictly; the default pool is the evaluated queries themselves"),
    Decision("Similarity", "not stated", "cosine; l2 and dot are options"),
    Decision("Rank of the best positive", "not stated for ties", "1 + images strictly more similar: ties favour the query; the count under the opposite rule is kept and a gap is reported"),
    Decision("R@K, DAR@K, RSR@K", "defined", "share of evaluated queries with rank ≤ K, without and with distractors; RSR@K = DAR@K / R@K, undefined where R@K is 0"),
    Decision("Mean over datasets", "unweighted", "unweighted mean of the datasets shown; equal means share the better rank"),
    Decision("Number sweep", "random samples of the pool", "round(ratio × pool size) images without replacement; the exact expectation over all draws, and the spread of nested draws (ten, a parameter of Fig. 6)"),
    Decision("Distance sweep", "distractors beyond a distance", "distance > minimum, strictly, from the threshold to infinity"),
    Decision("Condition sweep", "same number from each traversal", "each pool cut at random, by the seed, to the smallest pool"),
    Decision("Mixed database (Figs. 2, 9)", "5 % of a daytime traversal is added", "that share of a traversal with the query's kind of condition, drawn by the seed; any database image within the threshold is right"),
    Decision("Fitting region", "10 % of the queries; spatially disjoint", "the evaluated queries nearest to their mean position, and all database images within the threshold of any of them; 1-D positions: contiguous around the middle; Fig. 9: a slice from the edge of the map"),
    Decision("Evaluation region", "the rest", "queries outside the fitting region, database without the fitted images; queries left without a positive are excluded; the distractors are the evaluation queries"),
    Decision("INLP", "35 iterations, SGD classifier", "labels query against database; SGDClassifier(max_iter=2500, class_weight=\"balanced\", seed), else defaults; every direction is made orthogonal to the earlier ones, twice; with fewer images than dimensions the same algorithm runs in the span of the images"),
    Decision("LEACE", "the closed form", "no shrinkage, by least squares; directions in which the fitting data do not vary are left alone, and so are conditions that are guarded already: where labels and descriptors vary together by less than 1000 epsilons of what they vary alone"),
    Decision("STD", "mean and standard deviation per condition", "from the fitting region; a deviation that is zero counts as 1; distractors carry the query's condition"),
    Decision("Guardedness probe", "linear SVM", "LinearSVC() with defaults on the transformed descriptors, trained and tested on two spatial halves of the evaluation region, each balanced to 50 %, with a gap of the threshold between them; classifiers that do not converge are counted beside Fig. 8"),
    Decision("Several conditions", "sequential, in the paper's order", "each transform is fitted on descriptors that the earlier ones have changed; no scaling to unit length in between, once at the similarity; on pairs that no transform was fitted on (Table V), the places of every fitting region stay out"),
    Decision("Normalisation", "not stated", "descriptors have unit length before the fit, and again after suppression, in the similarity"),
    Decision("Image files", "not stated", "photographs are turned upright as their camera noted, what is transparent lies on white, 16-bit values are divided by 257; raw colour mosaics, 12-bit and float values are refused"),
    Decision("Image counts", "Table I", "a difference is a sentence on every page that uses the dataset, never a stop"),
    Decision("Input size", "not stated", "the authors' evaluation code of each method; a manifest value for each"),
    Decision("CricaVPR batches", "16 images", "16 in natural file order within a traversal, the last batch smaller; the same descriptors serve as query and as distractor"),
    Decision("Re-ranking (SelaVPR, SelaVPR++)", "top 100", "the first stage's top 100 of the augmented database are ranked again by the second stage; ties keep the first stage's order, ties at the cut favour the query; DAR may then exceed R and is never clipped; the number sweep is the mean of random draws (ten, at most three with local features), as Fig. 6 says"),
    Decision("Precision", "not stated", "descriptors float32, distances float64; no TF32; local features are stored as float16 only where the manifest says so"),
    Decision("Mean ± standard deviation (Tables IV, V)", "not stated", "of a sample (ddof = 1)"),
    Decision("Intervals", "none", "95 %, circular block bootstrap over consecutive queries, 1,000 resamples"),
)  # fmt: skip


def sensitivity(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Measure what the open choices change, without a second pass.

    Returns
    -------
    Study
        One row per dataset and method: ``R`` and ``DAR`` in percent under the defaults, and their change in
        percentage points: ``ties_R``, ``ties_DAR`` (ties against the query), ``excluded_R``, ``excluded_DAR``
        (excluded queries in the denominator), ``beyond_DAR`` (only distractors beyond twice the threshold; NaN
        where the threshold is 0).
    """
    rows, inputs = [], []
    for name in names:
        for method in methods:
            measured = evaluated.evaluation(manifest, name, method, seed=seed)
            result = measured.evaluation
            recall, dar = result.recall(k), result.dar(k)
            kept = result.n_queries / (result.n_queries + result.excluded_queries)
            beyond = result.dar_by_distance([2 * result.threshold], k)[0] - dar if result.threshold else np.nan
            changes = {
                "ties_R": result.recall(k, ties="against") - recall,
                "ties_DAR": result.dar(k, ties="against") - dar,
                "excluded_R": recall * (kept - 1),
                "excluded_DAR": dar * (kept - 1),
                "beyond_DAR": beyond,
            }
            row = {"dataset": name, "title": manifest.dataset(name).title, "method": method}
            row |= {"R": PERCENT * recall, "DAR": PERCENT * dar}
            rows.append(row | {column: PERCENT * change for column, change in changes.items()})
            inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))
