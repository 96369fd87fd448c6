"""Keys of everything that is stored: another input gives another key, the same inputs give the same."""

import dataclasses
import functools
import importlib.metadata
import inspect
import sys
from pathlib import Path

import numpy as np
import pytest
import synthetic
from conftest import HOG, REPOSITORY

from artifact import datasets, methods, suppression
from artifact.book import notebooks, runner
from artifact.datasets import appearance
from artifact.datasets.traversal import Traversal
from artifact.extraction import described as stage
from artifact.extraction import extract, local_features, stored
from artifact.extraction.described import Described
from artifact.manifest.entries import MethodEntry
from artifact.metrics import two_stage
from artifact.ranking import one_pass
from artifact.studies import composition, embedding, erased, evaluated, fitted, mixed_database, within_session

N = 60


class AskedError(Exception):
    """What a study asks the store for; nothing is computed."""


def ask(manifest, key, compute, record):
    raise AskedError(key)


def with_dataset(one, **changes):
    return dataclasses.replace(one, dataset=dataclasses.replace(one.dataset, **changes))


def moved(one, name):
    """One image of a traversal stands a metre from where it stood."""
    before = one.dataset.traversals
    positions = before[name].positions.copy()
    positions[3] += [0, 1]
    return with_dataset(one, traversals=before | {name: dataclasses.replace(before[name], positions=positions)})


def redescribed(one, name):
    other = dataclasses.replace(one.descriptors[name], sha256="other", key="other")
    return dataclasses.replace(one, descriptors=one.descriptors | {name: other})


INPUTS = {
    "threshold": lambda one: with_dataset(one, threshold=one.dataset.threshold + 1),
    "pair": lambda one: with_dataset(one, query_name="night", database_name="day"),
    **{f"positions of {name}": functools.partial(moved, name=name) for name in ("day", "night")},
    **{f"descriptors of {name}": functools.partial(redescribed, name=name) for name in ("day", "night")},
}
OF_DUSK = {
    "positions of dusk": functools.partial(moved, name="dusk"),
    "descriptors of dusk": functools.partial(redescribed, name="dusk"),
}

FITTING = {"fraction": 0.2, "iterations": 3, "seed": 1}
FITTED = [(one_pass, "REVISION"), (suppression, "REVISION"), (fitted, "REVISION")]


def within(manifest, dataset, method, *, statistics=("brightness",), **options):
    return within_session.within_session(manifest, [dataset], [method], statistics, **options)


def single_and_multi(manifest, dataset, method, **fitting):
    return composition.single_against_multi(manifest, [dataset], [method], **fitting)


def irrelevant(manifest, dataset, method, **fitting):
    return composition.irrelevant_conditions(manifest, [dataset], [method], **fitting)


# A study, other values of its parameters, the constants in the library that it depends on, further inputs.
STUDIES = {
    "evaluation": (
        functools.partial(evaluated.evaluation, distractors=["dusk"]),
        {"distractors": [], "pool_size": 9, "retrieve": 2, "similarity": "dot", "draws": 4, "seed": 1},
        [(one_pass, "REVISION")],
        OF_DUSK,
    ),
    "compare": (fitted.compare, FITTING, FITTED, {}),
    "by_fraction": (
        functools.partial(fitted.by_fraction, fractions=[0.2, 0.4]),
        {"fractions": [0.2, 0.3], "iterations": 3, "seed": 1},
        FITTED,
        {},
    ),
    "what_is_erased": (erased.what_is_erased, FITTING, [*FITTED, (erased, "PAIRS")], {}),
    "embedding": (embedding.embedding, FITTING, FITTED, {}),
    "mixed": (mixed_database.mixed_database, {"share": 0.1, "seed": 1}, FITTED, OF_DUSK),
    "mixed suppressed": (mixed_database.mixed_database_suppressed, {"share": 0.1} | FITTING, FITTED, OF_DUSK),
    "single and multi": (single_and_multi, FITTING, FITTED, {}),
    "irrelevant": (irrelevant, FITTING, FITTED, OF_DUSK),
    "within": (within, {"statistics": ["contrast"]} | FITTING, [*FITTED, (within_session, "CONTROLS")], {}),
}


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Let the studies find what ``world`` holds, and stop where they look into the store."""
    one = synthetic.described(n=N, threshold=15.0)
    world = {"described": one, "measures": np.random.default_rng(0).uniform(size=(N, 4))}

    def describe(_, dataset, method, traversals=(), *, device=None):
        now = world["described"]
        names = dict.fromkeys([now.dataset.query_name, now.dataset.database_name, *traversals])
        kept = {name: now.dataset.traversals[name] for name in names}
        loaded = dataclasses.replace(now.dataset, traversals=kept)
        return Described(loaded, method, {name: now.descriptors[name] for name in names})

    original = stage.describe
    for module in [m for name, m in sys.modules.items() if name.startswith("artifact.")]:
        if getattr(module, "describe", None) is original:
            monkeypatch.setattr(module, "describe", describe)
    monkeypatch.setattr(datasets, "load", lambda m, name, more=(): describe(m, name, "", more).dataset)
    for module in (composition, evaluated, fitted, erased, embedding, mixed_database, within_session):
        monkeypatch.setattr(module, "stored", ask)
    monkeypatch.setattr(within_session, "appearance", lambda *_: world["measures"])
    world["manifest"] = synthetic.manifest(tmp_path, one)
    return world


def key_of(world, study, **options):
    with pytest.raises(AskedError) as asked:
        study(world["manifest"], "made", synthetic.METHOD, **options)
    return str(asked.value)


@pytest.mark.parametrize("name", STUDIES)
def test_every_input_of_a_study_is_in_its_key(world, name, monkeypatch):
    study, other, constants, further = STUDIES[name]
    base = key_of(world, study)
    seen = {"nothing": base}
    assert key_of(world, study) == base, "the same inputs give the same key"
    for parameter, value in other.items():
        seen[parameter] = key_of(world, study, **{parameter: value})
    before = world["described"]
    for what, change in (INPUTS | further).items():
        world["described"] = change(before)
        seen[what] = key_of(world, study)
        world["described"] = before
    for module, constant in constants:
        with monkeypatch.context() as patch:
            patch.setattr(module, constant, getattr(module, constant) + 1)
            seen[f"{module.__name__}.{constant}"] = key_of(world, study)
    equal = [(a, b) for a in seen for b in seen if a < b and seen[a] == seen[b]]
    assert not equal
    assert key_of(world, study) == base


@pytest.mark.parametrize("name", STUDIES)
def test_no_parameter_of_a_study_is_forgotten_here(name):
    study, other, *_ = STUDIES[name]
    function = getattr(study, "func", study)
    parameters = [p for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD]
    named = {p.name for p in parameters} - {"manifest", "dataset", "method", "device"}
    if len(parameters) < len(inspect.signature(function).parameters):
        named |= {field.name for field in dataclasses.fields(fitted.Fitting)}
    assert set(other) == named


@pytest.mark.parametrize(
    "name", [name for name, (_, _, constants, _) in STUDIES.items() if set(FITTED) <= set(constants)]
)
def test_libraries_that_decide_a_fit_are_in_its_key(world, name, monkeypatch):
    study = STUDIES[name][0]
    base, original = key_of(world, study), importlib.metadata.version
    for module in (fitted, embedding):
        monkeypatch.setattr(module, "version", lambda of: "0" if of in ("scikit-learn", "umap-learn") else original(of))
    assert key_of(world, study) != base
    if name == "embedding":
        monkeypatch.setattr(fitted, "version", original)
        assert key_of(world, study) != base


def test_what_a_statistic_says_of_each_image_is_in_the_key(world):
    base = key_of(world, within)
    world["measures"] = world["measures"].copy()
    world["measures"][5, 0] += 1e-9
    assert key_of(world, within) != base


def test_the_fits_of_several_datasets_are_told_apart_by_order_and_method(world):
    def key(names, suppressor, **options):
        with pytest.raises(AskedError) as asked:
            described = dict.fromkeys(names, world["described"])
            fitted.sequential(world["manifest"], described, synthetic.METHOD, suppressor, fitted.Fitting(**options))
        return str(asked.value)

    base, one = key(["made"], "LEACE"), world["described"]
    other = [key(["made", "again"], "LEACE"), key(["made"], "INLP")]
    other += [key(["made"], "LEACE", **{name: value}) for name, value in FITTING.items()]
    for change in INPUTS.values():
        world["described"] = change(one)
        other.append(key(["made"], "LEACE"))
    assert len({base, *other}) == 1 + len(other)


# -- two-stage methods ----------------------------------------------------------------------------------------------


@pytest.fixture
def two(world, monkeypatch):
    """A method with codes; the study is asked for its ranking or for its sweep."""
    manifest = world["manifest"]
    entry = manifest.methods[synthetic.METHOD].model_copy(update={"rerank": 20, "code_bits": 64})
    world["manifest"] = dataclasses.replace(manifest, methods={synthetic.METHOD: entry})
    monkeypatch.setattr(extract, "check_disk", lambda *_: None)

    def changed(**update):
        world["manifest"] = dataclasses.replace(manifest, methods={synthetic.METHOD: entry.model_copy(update=update)})

    def of_sweep(manifest, dataset, method, **options):
        found = {}

        def first_only(of, key, compute, record):
            if record["stage"] == "two-stage sweep":
                raise AskedError(key)
            return {}

        def ranked(arrays, sweep_of):
            found["sweep"] = sweep_of
            raise StopIteration

        with monkeypatch.context() as patch:
            patch.setattr(evaluated, "stored", first_only)
            patch.setattr(two_stage.TwoStageEvaluation, "from_arrays", ranked)
            with pytest.raises(StopIteration):
                evaluated.evaluation(manifest, dataset, method, **options)
            found["sweep"](next(iter(options.get("distractors", ["queries"]))))

    return changed, of_sweep


@pytest.mark.parametrize("stage_name", ["ranking", "sweep"])
def test_every_input_of_two_stages_is_in_their_keys(world, two, stage_name, monkeypatch):
    changed, of_sweep = two
    study = evaluated.evaluation if stage_name == "ranking" else of_sweep
    study = functools.partial(study, distractors=["dusk"])
    base, seen, before = key_of(world, study), {}, world["described"]
    assert key_of(world, study) == base
    own = {"retrieve": 3} if stage_name == "ranking" else {"draws": 4}
    for parameter, value in ({"distractors": ["night"], "pool_size": 9, "seed": 1} | own).items():
        seen[parameter] = key_of(world, study, **{parameter: value})
    for what, change in (INPUTS | OF_DUSK).items():
        world["described"] = change(before)
        seen[what] = key_of(world, study)
    world["described"] = before
    changed(rerank=30)
    seen["candidates"] = key_of(world, study)
    changed(code_bits=128)
    seen["codes"] = key_of(world, study)
    changed()
    monkeypatch.setattr(two_stage, "REVISION", two_stage.REVISION + 1)
    seen["revision"] = key_of(world, study)
    assert len({base, *seen.values()}) == 1 + len(seen), seen


# -- descriptors, local features, statistics of images --------------------------------------------------------------


def traversal(digest="a" * 64):
    return Traversal("made", "day", "day", ("0.png",), np.zeros((1, 2)), digest, Path("nowhere"))


def entry(**changes):
    return MethodEntry(**(HOG | {"aggregation": "hog"} | changes))


LOCAL = {"shape": [3, 4, 8], "dtype": "float32"}


def test_every_input_of_descriptors_is_in_their_key(monkeypatch):
    key = stored.descriptor_key
    base, rule = key(traversal(), "hog", entry()), HOG["preprocessing"]
    seen = {
        "images": key(traversal("b" * 64), "hog", entry()),
        "method": key(traversal(), "thumbnail", entry()),
        "builder": key(traversal(), "hog", entry(builder="made_in_parts:Both")),
        "other builder": key(traversal(), "hog", entry(builder="made_in_parts:all_of_it")),
        **{f"precision {p}": key(traversal(), "hog", entry(), p) for p in ("bfloat16", "float16")},
        "batches": key(traversal(), "hog", entry(batch_dependent=True)),
        "larger batches": key(traversal(), "hog", entry(batch_dependent=True, batch_size=9)),
    }
    for name, value in {"size": [32, 32], "colour": "rgb", "interpolation": "bicubic", "std": [0.5]}.items():
        channels = {"mean": [0.0] * 3, "std": [1.0] * 3} if value == "rgb" else {}
        seen[name] = key(traversal(), "hog", entry(preprocessing={**rule, name: value, **channels}))
    for where, name, value in (
        (stored, "REVISION", stored.REVISION + 1),
        (methods, "_BUILDERS", {"hog": ("artifact.methods.hog:HOG", 99)}),
        (methods, "_source_digest", lambda builder: "another source"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(where, name, value)
            by = {"builder": "made_in_parts:Both"} if name == "_source_digest" else {}
            seen[f"{where.__name__}.{name}"] = key(traversal(), "hog", entry(**by))
    assert len({base, *seen.values()}) == 1 + len(seen), seen
    for same in (entry(title="Another"), entry(batch_size=99), entry(licence="MIT")):
        assert key(traversal(), "hog", same) == base


def test_every_input_of_local_features_is_in_their_key(monkeypatch):
    key, method = stored.second_stage_key, functools.partial(entry, rerank=10)
    base = key(traversal(), "hog", method(local_features=LOCAL))
    seen = [
        key(traversal("b" * 64), "hog", method(local_features=LOCAL)),
        key(traversal(), "hog", method(local_features=LOCAL), "float16"),
        key(traversal(), "hog", method(local_features=LOCAL | {"dtype": "float16"})),
        key(traversal(), "hog", method(local_features=LOCAL | {"shape": [4, 3, 8]})),
        key(traversal(), "hog", method(code_bits=64)),
    ]
    monkeypatch.setattr(local_features, "REVISION", local_features.REVISION + 1)
    seen.append(key(traversal(), "hog", method(local_features=LOCAL)))
    assert len({base, *seen}) == 1 + len(seen)


def test_statistics_of_images_are_those_of_their_content_and_code(monkeypatch):
    base = appearance.appearance_key(traversal())
    assert appearance.appearance_key(traversal()) == base != appearance.appearance_key(traversal("b" * 64))
    monkeypatch.setattr(appearance, "REVISION", appearance.REVISION + 1)
    assert appearance.appearance_key(traversal()) != base


# -- notebooks ------------------------------------------------------------------------------------------------------


def test_every_input_of_a_notebook_is_in_its_key(world, tmp_path):
    manifest, source = world["manifest"], tmp_path / "page.py"
    source.write_text((REPOSITORY / "notebooks" / "tab03.py").read_text())
    task = notebooks.Task(source, {"k": 1}, ("made",), (synthetic.METHOD,))
    shared, prints = {"sources": "a", "versions": "b"}, {"made": ["x"], "other": ["x"]}
    base = runner._key(manifest, task, shared, prints)
    assert runner._key(manifest, task, dict(shared), dict(prints)) == base
    seen = [
        runner._key(manifest, dataclasses.replace(task, parameters={"k": 5}), shared, prints),
        runner._key(manifest, dataclasses.replace(task, parameters={"k": 1, "seed": 0}), shared, prints),
        runner._key(manifest, dataclasses.replace(task, datasets=("made", "other")), shared, prints),
        runner._key(manifest, dataclasses.replace(task, methods=()), shared, prints),
        runner._key(manifest, task, shared | {"sources": "c"}, prints),
        runner._key(manifest, task, shared, prints | {"made": ["y"]}),
    ]
    changed = manifest.methods[synthetic.METHOD].model_copy(update={"batch_dependent": True})
    other = dataclasses.replace(manifest, methods={synthetic.METHOD: changed})
    seen.append(runner._key(other, task, shared, prints))
    source.write_text(source.read_text().replace("# %%", "# %%\n# more", 1))
    seen.append(runner._key(manifest, task, shared, prints))
    assert len({base, *seen}) == 1 + len(seen)
