"""The command line: ``python -m artifact {reproduce,data,extract,run,book,evaluate,results,verify,bench,plan,status}``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from artifact import __version__

_Function = Callable[[argparse.Namespace], int | None]
EPILOG = "The Makefile calls these commands; `make help` lists them. See README.md for what each costs."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status: 0, 1 for a failed run, 2 for unusable arguments."""
    # Threads of the models sleep while they wait: where they spin, a process that reads images beside them on a machine
    # of few cores slows a forward pass several times. Read once, when PyTorch is imported; notebooks inherit it.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        return options.command(options) or 0
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="artifact", description=__doc__.splitlines()[0], epilog=EPILOG)
    parser.add_argument("--version", action="version", version=f"artifact {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")

    def command(name: str, function: _Function, text: str) -> argparse.ArgumentParser:
        sub = _action(commands, name, function, text)
        sub.add_argument("--manifest", type=Path, help="manifest file (default: the nearest data_manifest.yaml)")
        sub.add_argument("--trust", action="store_true", help="run the builders that a manifest from elsewhere names")
        return sub

    def scoped(name: str, function: _Function, text: str) -> argparse.ArgumentParser:
        sub = command(name, function, text)
        sub.add_argument("--profile", default="demo", help="profile of the manifest (default: demo)")
        return sub

    text = "make datasets and descriptors ready, run the notebooks, build the book"
    _run_options(scoped("reproduce", partial(_run, book=True), text))
    _run_options(scoped("run", _run, "as reproduce, without building the book"))
    command("book", _book, "build the book from the executed notebooks, running none")
    text = "make the datasets and weights of a profile ready and say which are missing"
    _data_options(scoped("data", _data, text))
    _extract_options(scoped("extract", _extract, "extract the descriptors of a profile"))
    _evaluate_options(scoped("evaluate", _evaluate, "print R@K, DAR@K and RSR@K of datasets and methods"))
    _suppress_commands(command)
    _results_commands(command)
    text = "check stored results against their records and measurements against the paper"
    sub = scoped("verify", _verify, text)
    text = "delete what is damaged and all that was made from it, and make it again"
    sub.add_argument("--repair", action="store_true", help=text)
    text = "compute this anew from images, and compare with what is stored"
    sub.add_argument("--recompute", metavar="'DATASET x METHOD'", help=text)
    text = "time the ranking pass against a bare matrix product, and extraction against the model"
    sub = command("bench", _bench, text)
    text = "time these methods instead (default: the paper's), for Table II"
    sub.add_argument("--methods", nargs="*", metavar="METHOD", help=text)
    text = "say what a whole run takes on this machine: time, memory and disk of every step"
    _plan_options(scoped("plan", _plan, text))
    scoped("status", _status, "show the state of data, descriptors and the last run")
    command("cluster-example", _cluster_example, "write cluster.yaml, options of queueing systems to fill in")
    return parser


def _action(commands: Any, name: str, function: _Function, text: str) -> argparse.ArgumentParser:
    sub = commands.add_parser(name, help=text, description=text)
    sub.set_defaults(command=function)
    return sub


def _run_options(sub: argparse.ArgumentParser) -> None:
    text = "run only these, for example: tab03 fig05"
    sub.add_argument("--only", nargs="+", default=[], metavar="NOTEBOOK", help=text)
    name, text = (
        "[NOTEBOOK.]NAME=VALUE",
        "set a notebook parameter, for one notebook or for all that have it; VALUE is YAML",
    )
    sub.add_argument("-p", "--parameter", action="append", default=[], metavar=name, help=text)
    text = "several such parameters, with spaces between, as make SET='…'"
    sub.add_argument("--set", default="", metavar="TEXT", help=text)
    sub.add_argument("--jobs", type=int, help="notebooks that run at once (default: one more than there are cores)")
    sub.add_argument("--force", action="store_true", help="run notebooks again even where nothing changed")
    _work_options(sub)


def _work_options(sub: argparse.ArgumentParser) -> None:
    text = "local, slurm, pbs, lsf, sge, or a scheduler's address (default: local with several CUDA devices, else none)"
    sub.add_argument("--cluster", default="", metavar="WHERE", help=text)
    text = "read every image, also those not written since the last time"
    sub.add_argument("--check-images", action="store_true", help=text)


def _extract_options(sub: argparse.ArgumentParser) -> None:
    text = "for example cpu, cuda:1, cuda:0,cuda:1 or all (default: one CUDA device if there is any)"
    sub.add_argument("--devices", "--device", metavar="DEVICES", help=text)
    text = "mixed precision gives other descriptors, stored beside the former (default: float32)"
    sub.add_argument("--precision", choices=("float32", "bfloat16", "float16"), default="float32", help=text)
    _work_options(sub)
    sub.add_argument("--dry-run", action="store_true", help="extract nothing; say what it takes on this machine")
    text = "for maintainers: store this dataset's descriptors in the package, or of a rendered one VLAD's vocabulary"
    sub.add_argument("--ship", metavar="DATASET", help=text)


def _plan_options(sub: argparse.ArgumentParser) -> None:
    text = "write the plan as a table instead, for the page Full run"
    sub.add_argument("--csv", type=Path, metavar="FILE", help=text)
    sub.add_argument("--devices", "--device", metavar="DEVICES", help="devices of extraction, as for extract")
    sub.add_argument("--jobs", action="store_true", help="list the jobs instead, with time, memory and what they need")
    text = "foretell the schedule on so many workers instead (default: 1 8 64 512)"
    sub.add_argument("--workers", nargs="*", type=_positive, metavar="N", help=text)
    sub.add_argument("--gpus", type=_positive, default=0, metavar="N", help="of the workers, how many have a GPU")


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be 1 or more")
    return value


def _evaluate_options(sub: argparse.ArgumentParser) -> None:
    """Options of ``evaluate``: datasets and methods, or descriptors in files."""
    sub.add_argument("--datasets", nargs="+", help="names or folders (default: those of the profile)")
    sub.add_argument("--methods", nargs="+", help="names (default: those of the profile)")
    sub.add_argument("--k", type=int, nargs="+", default=[], help="K (default: 1; for files 1, 5 and 10)")
    group = sub.add_argument_group("descriptors in files, instead of datasets and methods")
    group.add_argument("--queries", type=Path, metavar="FILE", help=".npy, .npz, .safetensors or .h5 (hloc's layout)")
    group.add_argument("--database", type=Path, metavar="FILE", help="the same for the database")
    where = "CSV (image,x,y or image,index), .npy, list or folder of @utm_east@utm_north@ names (default: frame order)"
    group.add_argument("--query-positions", type=Path, metavar="FILE", help=where)
    group.add_argument("--database-positions", type=Path, metavar="FILE", help="the same for the database")
    group.add_argument("--threshold", metavar="T", help="25m, 2frames or exact")
    text = "pools of distractors instead of the queries"
    group.add_argument("--distractors", nargs="+", default=[], metavar="NAME=FILE[,POSITIONS]", help=text)
    group.add_argument("--suppress", nargs="+", choices=("INLP", "LEACE", "STD"), default=[], help="fit and compare")
    group.add_argument("--fraction", type=float, default=0.1, help="query fitting fraction (default: 0.1)")
    group.add_argument("--seed", type=int, default=0, help="seed of INLP and of the intervals (default: 0)")
    group.add_argument("--per-query", type=Path, metavar="CSV", help="write one row for each evaluated query")
    group.add_argument("--json", action="store_true", help="print JSON instead of a table")


def _data_options(sub: argparse.ArgumentParser) -> None:
    """Options of ``data`` for published datasets, of ``data status`` and ``data add``."""
    text = "obtain and prepare these from published files"
    sub.add_argument("--dataset", nargs="+", default=[], metavar="NAME", help=text)
    sub.add_argument("--traversal", nargs="+", default=[], metavar="NAME", help="of the dataset, only these")
    sub.add_argument("--set", default="", metavar="TEXT", help="parameters of the preparation, as make SET='poses=ins'")
    actions = sub.add_subparsers(metavar="{status,add}", title="what is here, and own images")
    text = "show which published datasets are here, verified or missing, and how to get them"
    _action(actions, "status", _data_status, text)
    add = _action(actions, "add", _add, "describe folders of images as a dataset, after a look at them")
    add.add_argument("name", metavar="NAME", help="folder that will hold dataset.yaml and preview.html")
    add.add_argument("--query", required=True, metavar="[NAME=]DIR", help="images of the query traversal")
    text = "images of the same places, other condition"
    add.add_argument("--database", required=True, metavar="[NAME=]DIR", help=text)
    text = "a further pool of distractors"
    add.add_argument("--traversal", action="append", default=[], metavar="NAME=DIR", help=text)
    where = add.add_mutually_exclusive_group()
    where.add_argument("--positions", nargs="+", metavar="CSV", help="one file for all traversals, or one for each")
    where.add_argument("--names", action="store_true", help="positions are in the names: @utm_east@utm_north@….jpg")
    where.add_argument("--order", action="store_true", help="the n-th images of all folders show the same place")
    add.add_argument("--threshold", metavar="T", help="25m, 2frames or exact (default: 25m, or 1frame without metres)")
    add.add_argument("--dry-run", action="store_true", help="look only, write nothing")


def _results_commands(command: Callable[..., argparse.ArgumentParser]) -> None:
    sub = command("results", _results_import, "pass results on, or read those of others")
    actions = sub.add_subparsers(required=True, metavar="action")
    text = "write the results that the pages of a profile read into one file"
    export = _action(actions, "export", _results_export, text)
    export.add_argument("file", type=Path, metavar="FILE.zip")
    export.add_argument("--profile", default="paper", help="profile of the manifest (default: paper)")
    text = "check such a file and read it, so that reproduce builds the book from it"
    reading = _action(actions, "import", _results_import, text)
    reading.add_argument("file", type=Path, metavar="FILE.zip")


def _suppress_commands(command: Callable[..., argparse.ArgumentParser]) -> None:
    sub = command("suppress", _suppress_fit, "fit a suppression transform on descriptors in files, or apply one")
    actions = sub.add_subparsers(required=True, metavar="action")
    text = "fit on the descriptors of two conditions and save the transform"
    fit = _action(actions, "fit", _suppress_fit, text)
    fit.add_argument("--queries", type=Path, required=True, metavar="FILE", help=".npy, .npz, .safetensors or .h5")
    fit.add_argument("--database", type=Path, required=True, metavar="FILE", help="the same of the database")
    fit.add_argument("--method", choices=("INLP", "LEACE", "STD"), default="LEACE", help="(default: LEACE)")
    fit.add_argument("--seed", type=int, default=0, help="seed of INLP (default: 0)")
    fit.add_argument("--save", type=Path, required=True, metavar="FILE.npz", help="where to write it")
    apply = _action(actions, "apply", _suppress_apply, "apply a saved transform to descriptors")
    apply.add_argument("transform", type=Path, metavar="FILE.npz")
    apply.add_argument("descriptors", type=Path, metavar="FILE")
    apply.add_argument("out", type=Path, metavar="OUT.npy")
    apply.add_argument("--condition", choices=("query", "database"), help="of the descriptors; STD needs it")


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


def asked_parameters(texts: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Parse ``[notebook.]name=value`` texts; ``"*"`` stands for all notebooks.

    Examples
    --------
    >>> asked_parameters(["k=5", "fig06.ratios=[0, 0.5, 1]"])
    {'*': {'k': 5}, 'fig06': {'ratios': [0, 0.5, 1]}}
    """
    from artifact.book.parameters import ParameterError

    asked: dict[str, dict[str, Any]] = {}
    for text in texts:
        target, equals, value = text.partition("=")
        notebook, dot, name = target.rpartition(".")
        if not equals or not name.isidentifier() or (dot and not notebook):
            raise ParameterError(f"{text!r} is not [NOTEBOOK.]NAME=VALUE, for example k=5 or fig06.k=5")
        try:
            asked.setdefault(notebook or "*", {})[name] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ParameterError(f"{text!r}: the value is not valid YAML") from None
    return asked


def assignments(text: str) -> list[str]:
    """Split a text at the spaces that are in no quotes and no brackets.

    Examples
    --------
    >>> assignments("k=5  fig06.ratios=[0, 0.5] datasets=['my town']")
    ['k=5', 'fig06.ratios=[0, 0.5]', "datasets=['my town']"]
    """
    parts, quote, depth = [""], "", 0
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        else:
            depth += (character in "[{(") - (character in "]})")
        if character.isspace() and not quote and depth <= 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part for part in parts if part]


def _run(options: argparse.Namespace, *, book: bool = False) -> None:
    from artifact import store
    from artifact.book import build, runner, stages, status
    from artifact.commands import data, verify

    manifest = _manifest(options)
    store.sweep(manifest.cache)
    asked = asked_parameters([*options.parameter, *assignments(options.set)])
    tasks = runner.with_what_is_here(manifest, runner.plan(manifest, options.profile, only=options.only, asked=asked))
    data.require(manifest, tasks)
    if options.check_images:
        _print(verify.changed_files(manifest, runner.datasets_of(tasks)))
    with stages.measured() as reported:
        with store.stage("preparation"):
            _on_cluster(options, manifest, tasks)
            runner.prepare(manifest, tasks)
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
    from artifact.book import runner

    manifest = _manifest(options)
    if options.dataset:
        return _obtain(manifest, options)
    missing = 0
    for name in manifest.profile(options.profile).datasets:
        try:
            traversals = runner.load_all(manifest, name)
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
    from artifact.book import runner
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
    described = runner.Task(Path("extract"), {}, tuple(profile.datasets), tuple(profile.methods))
    data.require(manifest, [described])
    if options.check_images:
        _print(verify.changed_files(manifest, profile.datasets))
    traversals = [traversal for name in profile.datasets for traversal in runner.load_all(manifest, name)]
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
