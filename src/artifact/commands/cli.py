"""The command line: what each command of ``python -m artifact`` does."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from artifact.commands.arguments import asked_parameters, assignments, parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status: 0, 1 for a failed run, 2 for unusable arguments."""
    # Threads of the models sleep while they wait: where they spin, a process that reads images beside them on a machine
    # of few cores slows a forward pass several times; those of NumPy's products spin 2¹⁸ cycles instead of 2²⁶. Read once,
    # when PyTorch and NumPy are imported; notebooks inherit it.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "18")
    options = parser().parse_args(arguments)
    try:
        return _COMMANDS[options.command](options) or 0
    except KeyboardInterrupt:
        sys.stderr.write("\nstopped; what is finished stays, run the same command again to go on\n")
        return 130
    except _user_errors() as error:
        sys.stderr.write(f"error: {_in_words(error)}\n")
        return 1


def _in_words(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'a file'}: {error.strerror}; what is finished stays, run again when that is mended"
    return str(error)


def _user_errors() -> tuple[type[Exception], ...]:
    """Errors that are addressed to the user: shown without a traceback."""
    from artifact.book.build import BookError
    from artifact.book.parameters import ParameterError
    from artifact.book.runner import NotebookError
    from artifact.commands.workers import ClusterError
    from artifact.datasets import DatasetError
    from artifact.extraction.reading import ExtractionError
    from artifact.manifest.entries import ManifestError
    from artifact.methods.weights import WeightsError
    from artifact.store import StoreError

    of_inputs = (DatasetError, ManifestError, ParameterError, WeightsError)
    return (*of_inputs, BookError, ClusterError, ExtractionError, NotebookError, StoreError, OSError)


def _cluster_example(options: argparse.Namespace) -> None:
    from artifact import store
    from artifact.commands import workers

    path = _manifest(options).path.parent / workers.OPTIONS
    if path.exists():
        raise workers.ClusterError(f"{path}: is there already; delete it to write a new one")
    with store.replacing(path) as temporary:
        temporary.write_text(workers.EXAMPLE, encoding="utf-8")
    sys.stdout.write(f"{path} written: fill it in, then make reproduce CLUSTER=slurm\n")


def _results_export(options: argparse.Namespace) -> None:
    from artifact.commands import results

    _print(results.export(_manifest(options), options.profile, options.file))


def _results_import(options: argparse.Namespace) -> None:
    from artifact.commands import results

    _print(results.read(_manifest(options), options.file))


def _suppress_fit(options: argparse.Namespace) -> None:
    from artifact.commands import suppress

    _print(suppress.fit(options))


def _suppress_apply(options: argparse.Namespace) -> None:
    from artifact.commands import suppress

    _print(suppress.apply(options))


def _add(options: argparse.Namespace) -> None:
    from artifact.commands import add

    _print(add.run(_manifest(options), options))


def _manifest(options: argparse.Namespace, *, make: bool = True) -> Any:
    """Load the manifest as the profile sees it; ``make`` writes made descriptors that are missing."""
    from artifact import manifest

    loaded = manifest.load(options.manifest)
    if not options.trust:
        manifest.refuse_code_from_elsewhere(loaded)
    if "profile" not in options:
        return loaded
    from artifact.extraction import made

    loaded = loaded.for_profile(options.profile)
    if make:
        made.make(loaded, options.profile)
    return loaded


def _run(options: argparse.Namespace, *, book: bool = False) -> None:
    from artifact import store
    from artifact.book import build, notebooks, runner, stages, status
    from artifact.commands import data, verify

    manifest = _manifest(options)
    store.sweep(manifest.cache)
    asked = asked_parameters([*options.parameter, *assignments(options.set)])
    tasks = notebooks.with_what_is_here(
        manifest, notebooks.plan(manifest, options.profile, only=options.only, asked=asked)
    )
    data.require(manifest, tasks)
    if options.check_images:
        _print(verify.changed_files(manifest, notebooks.datasets_of(tasks)))
    with stages.measured() as reported:
        with store.stage("preparation"):
            _on_cluster(options, manifest, tasks)
            notebooks.prepare(manifest, tasks)
        with build.alone(manifest):
            executed = build.executed_folder(manifest)
            with store.stage("notebooks"):
                outcomes = runner.run(manifest, tasks, executed, jobs=options.jobs, force=options.force)
            status.record_run(manifest, options.profile, tasks, outcomes, stages.lines(reported))
            ran = [outcome for outcome in outcomes if not outcome.cached]
            sys.stdout.write(f"notebooks: {len(ran)} run, {len(outcomes) - len(ran)} unchanged\n")
            if book:
                with store.stage("book"):
                    _build(manifest)
        _print(stages.lines(reported))


def _on_cluster(options: argparse.Namespace, manifest: Any, tasks: Any, precision: str = "float32") -> None:
    """Do the heavy work of a run on the cluster that was asked for, if any."""
    from artifact.commands import cluster, workers

    where = options.cluster or ("local" if workers.devices() > 1 and workers.is_there() else "")
    if where:
        _print(cluster.lines(where, manifest, tasks, precision=precision))


def _book(options: argparse.Namespace) -> None:
    from artifact.book import build

    manifest = _manifest(options)
    with build.alone(manifest):
        _build(manifest)


def _build(manifest: Any) -> None:
    from artifact.book import build

    built, seconds = build.build(manifest)
    what = f"built in {seconds:.0f} s" if seconds is not None else "unchanged"
    sys.stdout.write(f"book: {what}; open {built}\n")
    if counted := build.tally(manifest):
        sys.stdout.write(f"{counted}\n")


def _data_status(options: argparse.Namespace) -> None:
    from artifact.commands import data

    _print(data.status_lines(_manifest(options)))


def _data(options: argparse.Namespace) -> int:
    from artifact import datasets
    from artifact.book import notebooks

    manifest = _manifest(options)
    if options.dataset:
        return _obtain(manifest, options)
    missing = 0
    for name in manifest.profile(options.profile).datasets:
        try:
            traversals = notebooks.load_all(manifest, name)
        except datasets.DatasetError as error:
            missing += 1
            sys.stdout.write(f"{name}: missing\n{error}\n")
            continue
        for traversal in traversals:
            without = "records of a results bundle" if traversal.descriptors else "shipped descriptors only"
            state = str(traversal.folder) if traversal.folder else without
            sys.stdout.write(f"{name}/{traversal.name}: {len(traversal)} images, {state}\n")
    missing += _fetch_weights(manifest, options.profile)
    return 1 if missing else 0


def _obtain(manifest: Any, options: argparse.Namespace) -> int:
    """Obtain and prepare published datasets; all that can be done is done before what is missing is said."""
    from artifact.book.parameters import ParameterError
    from artifact.datasets import DatasetError, published

    asked = asked_parameters(assignments(options.set))
    if named := [name for name in asked if name != "*"]:
        fault = "parameters of a preparation have no name before them, for example poses=ins"
        raise ParameterError(f"{named[0]!r}: {fault}")
    missing = 0
    for name in options.dataset:
        try:
            _print(published.obtain(manifest, name, options.traversal, asked.get("*", {})))
        except DatasetError as error:
            missing += 1
            sys.stderr.write(f"error: {error}\n")
    return 1 if missing else 0


def _fetch_weights(manifest: Any, profile: str) -> int:
    """Show licence and terms of all missing weights, then fetch them; return the number of methods left without."""
    from artifact import methods
    from artifact.methods import weights

    entries = {name: manifest.method(name) for name in manifest.profile(profile).methods}
    sys.stdout.write(weights.announcement(entries))
    missing = 0
    for name, entry in entries.items():
        if not weights.is_required(entry):
            continue
        sys.stdout.flush()
        try:
            methods.fetch(name, entry)
        except weights.WeightsError as error:
            missing += 1
            sys.stdout.write(f"{name}: no weights\n{error}\n")
            continue
        sys.stdout.write(f"weights of {weights.state(name, entry).summary}\n")
    return missing


def _extract(options: argparse.Namespace) -> None:
    from artifact.book import notebooks
    from artifact.commands import data, plan, ship, verify
    from artifact.extraction import extract
    from artifact.methods import weights

    manifest = _manifest(options)
    profile, how = manifest.profile(options.profile), {"device": options.devices, "precision": options.precision}
    if options.ship:
        _print(ship.ship(manifest, options.ship, profile.methods))
        return
    if options.dry_run:
        _print(plan.lines(manifest, options.profile, **how))
        return
    described = notebooks.Task(Path("extract"), {}, tuple(profile.datasets), tuple(profile.methods))
    data.require(manifest, [described])
    if options.check_images:
        _print(verify.changed_files(manifest, profile.datasets))
    traversals = [traversal for name in profile.datasets for traversal in notebooks.load_all(manifest, name)]
    weights.require({name: manifest.method(name) for name in profile.methods})
    extract.check_disk(manifest, traversals, profile.methods)
    if not options.devices:
        _on_cluster(options, manifest, [described], options.precision)
    for traversal in traversals:
        for method in profile.methods:
            found = extract.descriptors(manifest, traversal, method, progress=True, **how)
            label = f"{method} · {traversal.dataset}/{traversal.name}"
            sys.stdout.write(f"{label}: {found.values.shape} from {found.source}\n")


def _evaluate(options: argparse.Namespace) -> None:
    from artifact.commands import evaluate

    if options.queries or options.database:
        _print(evaluate.run(options))
        return
    from artifact.studies import preview, recall

    manifest = _manifest(options)
    profile = manifest.profile(options.profile)
    names = options.datasets or profile.datasets
    for name in names:
        if name not in manifest.datasets:
            _print([f"{name}:", *preview.look_at(manifest, name).lines(), ""])
    for k in options.k or [1]:
        study = recall.recall_table(manifest, names, options.methods or profile.methods, k=k)
        shown = study.table[["title", "method", "R", "DAR", "RSR", "queries", "origin"]]
        heading = f"K = {k}\n" if len(options.k) > 1 else ""
        sys.stdout.write(heading + shown.to_string(index=False, float_format=lambda value: f"{value:.2f}") + "\n")


def _verify(options: argparse.Namespace) -> int:
    from artifact.commands import verify

    manifest, failed = _manifest(options), []
    if options.recompute:
        from artifact.commands import recompute

        faults = 0
        for line, differs in recompute.lines(manifest, options.profile, options.recompute):
            sys.stdout.write(f"{line}\n")
            faults += differs
        return 1 if faults else 0
    if options.repair:
        same = ["--profile", options.profile, *(["--trust"] if options.trust else [])]
        same += ["--manifest", str(options.manifest)] if options.manifest else []
        _print(verify.repair(manifest, options.profile, lambda: failed.append(main(["reproduce", *same]))))
    lines, faults = verify.verify(manifest, options.profile)
    _print(lines)
    return 1 if faults or any(failed) else 0


def _bench(options: argparse.Namespace) -> None:
    from artifact.commands import bench
    from artifact.extraction import forward, timing

    manifest = _manifest(options)
    if options.methods is None:
        lines = bench.run(manifest)
    else:
        names = options.methods or [name for name, entry in manifest.methods.items() if entry.kind == "paper"]
        lines = timing.store_times(manifest, names, forward.devices(None)[0])
    _print(lines)


def _plan(options: argparse.Namespace) -> None:
    from artifact import store
    from artifact.commands import plan

    manifest = _manifest(options)
    if options.csv:
        with store.replacing(options.csv) as temporary:
            plan.run_frame(manifest, options.profile, device=options.devices).to_csv(temporary, index=False)
        sys.stdout.write(f"{options.csv} written\n")
        return
    if not options.jobs and options.workers is None:
        _print(plan.run_lines(manifest, options.profile, device=options.devices))
        return
    graph = plan.planned_jobs(manifest, options.profile, device=options.devices)
    if options.jobs:
        _print(plan.job_lines(graph))
    if options.workers is not None:
        _print(plan.schedule_lines(graph, options.workers or (1, 8, 64, 512), options.gpus))


def _print(lines: Iterable[str]) -> None:
    for line in lines:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()


def _status(options: argparse.Namespace) -> None:
    from artifact.book import status
    from artifact.methods import weights

    manifest = _manifest(options, make=False)
    for name in manifest.profile(options.profile).methods:
        state = weights.state(name, manifest.method(name))
        if state.status != "not needed":
            sys.stdout.write(f"weights of {state.detail if state.status == 'changed' else state.summary}\n")
    _print(status.status_lines(manifest, options.profile))


_COMMANDS: dict[str, Callable[[argparse.Namespace], int | None]] = {
    "reproduce": partial(_run, book=True),
    "run": _run,
    "book": _book,
    "data": _data,
    "data status": _data_status,
    "data add": _add,
    "extract": _extract,
    "evaluate": _evaluate,
    "suppress fit": _suppress_fit,
    "suppress apply": _suppress_apply,
    "results export": _results_export,
    "results import": _results_import,
    "verify": _verify,
    "bench": _bench,
    "plan": _plan,
    "status": _status,
    "cluster-example": _cluster_example,
}
