"""The command line: ``python -m artifact {reproduce,data,extract,run,book,evaluate,verify,bench,plan,status}``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from artifact import __version__

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
        sys.stderr.write(f"error: {error}\n")
        return 1


def _user_errors() -> tuple[type[Exception], ...]:
    """Errors that are addressed to the user: shown without a traceback."""
    from artifact.book.build import BookError
    from artifact.book.parameters import ParameterError
    from artifact.book.runner import NotebookError
    from artifact.datasets import DatasetError
    from artifact.extraction.extract import ExtractionError
    from artifact.manifest.entries import ManifestError
    from artifact.methods.weights import WeightsError
    from artifact.store import StoreError

    return (
        BookError,
        DatasetError,
        ExtractionError,
        ManifestError,
        ParameterError,
        NotebookError,
        StoreError,
        WeightsError,
        FileNotFoundError,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="artifact", description=__doc__.splitlines()[0], epilog=EPILOG)
    parser.add_argument("--version", action="version", version=f"artifact {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")

    def command(name: str, function: Callable[[argparse.Namespace], int | None], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(command=function)
        sub.add_argument("--manifest", type=Path, help="manifest file (default: the nearest data_manifest.yaml)")
        return sub

    def scope(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--profile", default="demo", help="profile of the manifest (default: demo)")

    def notebooks(sub: argparse.ArgumentParser) -> None:
        scope(sub)
        sub.add_argument(
            "--only",
            nargs="+",
            default=[],
            metavar="NOTEBOOK",
            help="run only these, for example: tab03 fig05",
        )
        sub.add_argument(
            "-p",
            "--parameter",
            action="append",
            default=[],
            metavar="[NOTEBOOK.]NAME=VALUE",
            help="set a notebook parameter, for one notebook or for all that have it; VALUE is YAML",
        )
        sub.add_argument(
            "--set", default="", metavar="TEXT", help="several such parameters, with spaces between, as make SET='…'"
        )
        sub.add_argument("--jobs", type=int, help="notebooks that run at once (default: the number of cores)")
        sub.add_argument("--force", action="store_true", help="run notebooks again even where nothing changed")

    sub = command("reproduce", _reproduce, "make datasets and descriptors ready, run the notebooks, build the book")
    notebooks(sub)
    sub = command("run", _run, "as reproduce, without building the book")
    notebooks(sub)
    sub = command("book", _book, "build the book from the executed notebooks, running none")
    sub = command("data", _data, "make the datasets and weights of a profile ready and say which are missing")
    scope(sub)
    _add_options(sub)
    sub = command("extract", _extract, "extract the descriptors of a profile")
    scope(sub)
    sub.add_argument(
        "--devices",
        "--device",
        metavar="DEVICES",
        help="for example cpu, cuda:1, cuda:0,cuda:1 or all (default: one CUDA device if there is any)",
    )
    sub.add_argument(
        "--precision",
        choices=("float32", "bfloat16", "float16"),
        default="float32",
        help="mixed precision gives other descriptors, stored beside the former (default: float32)",
    )
    sub.add_argument("--dry-run", action="store_true", help="extract nothing; say what it takes on this machine")
    sub.add_argument(
        "--ship", metavar="DATASET", help="for maintainers: store this dataset's descriptors in the package"
    )
    sub = command("evaluate", _evaluate, "print R@K, DAR@K and RSR@K of datasets and methods")
    scope(sub)
    sub.add_argument("--datasets", nargs="+", help="names or folders (default: those of the profile)")
    sub.add_argument("--methods", nargs="+", help="names (default: those of the profile)")
    sub.add_argument("--k", type=int, nargs="+", default=[], help="K (default: 1; for files 1, 5 and 10)")
    _descriptor_files(sub)
    sub = command("suppress", _suppress("fit"), "fit a suppression transform on descriptors in files, or apply one")
    _suppress_options(sub)
    sub = command(
        "verify",
        _verify,
        "check stored descriptors against their sidecars and measurements against the paper",
    )
    scope(sub)
    sub = command(
        "bench",
        _bench,
        "time the ranking pass against a bare matrix product, and extraction against the model",
    )
    sub.add_argument(
        "--methods", nargs="*", metavar="METHOD", help="time these methods instead (default: the paper's), for Table II"
    )
    sub = command("plan", _plan, "say what a whole run takes on this machine: time, memory and disk of every step")
    scope(sub)
    sub.add_argument("--devices", "--device", metavar="DEVICES", help="devices of extraction, as for extract")
    sub = command("status", _status, "show the state of data, descriptors and the last run")
    scope(sub)
    return parser


def _descriptor_files(sub: argparse.ArgumentParser) -> None:
    """Options of descriptors in files."""
    group = sub.add_argument_group("descriptors in files, instead of datasets and methods")
    group.add_argument("--queries", type=Path, metavar="FILE", help=".npy, .npz, .safetensors or .h5 (hloc's layout)")
    group.add_argument("--database", type=Path, metavar="FILE", help="the same for the database")
    where = "CSV (image,x,y or image,index), .npy, list or folder of @utm_east@utm_north@ names (default: frame order)"
    group.add_argument("--query-positions", type=Path, metavar="FILE", help=where)
    group.add_argument("--database-positions", type=Path, metavar="FILE", help="the same for the database")
    group.add_argument("--threshold", metavar="T", help="25m, 2frames or exact")
    group.add_argument(
        "--distractors",
        nargs="+",
        default=[],
        metavar="NAME=FILE[,POSITIONS]",
        help="pools of distractors instead of the queries",
    )
    group.add_argument("--suppress", nargs="+", choices=("INLP", "LEACE", "STD"), default=[], help="fit and compare")
    group.add_argument("--fraction", type=float, default=0.1, help="query fitting fraction (default: 0.1)")
    group.add_argument("--seed", type=int, default=0, help="seed of INLP and of the intervals (default: 0)")
    group.add_argument("--per-query", type=Path, metavar="CSV", help="write one row for each evaluated query")
    group.add_argument("--json", action="store_true", help="print JSON instead of a table")


def _add_options(sub: argparse.ArgumentParser) -> None:
    """Options of ``data add``."""
    text = "describe folders of images as a dataset, after a look at them"
    actions = sub.add_subparsers(metavar="add", title="own images")
    add = actions.add_parser("add", help=text, description=text)
    add.set_defaults(command=_add)
    add.add_argument("name", metavar="NAME", help="folder that will hold dataset.yaml and preview.html")
    add.add_argument("--query", required=True, metavar="[NAME=]DIR", help="images of the query traversal")
    add.add_argument(
        "--database", required=True, metavar="[NAME=]DIR", help="images of the same places, other condition"
    )
    add.add_argument(
        "--traversal", action="append", default=[], metavar="NAME=DIR", help="a further pool of distractors"
    )
    where = add.add_mutually_exclusive_group()
    where.add_argument("--positions", nargs="+", metavar="CSV", help="one file for all traversals, or one for each")
    where.add_argument("--names", action="store_true", help="positions are in the names: @utm_east@utm_north@….jpg")
    where.add_argument("--order", action="store_true", help="the n-th images of all folders show the same place")
    add.add_argument("--threshold", metavar="T", help="25m, 2frames or exact (default: 25m, or 1frame without metres)")
    add.add_argument("--dry-run", action="store_true", help="look only, write nothing")


def _suppress_options(sub: argparse.ArgumentParser) -> None:
    """Options of ``suppress fit`` and ``suppress apply``."""
    actions = sub.add_subparsers(required=True, metavar="action")
    text = "fit on the descriptors of two conditions and save the transform"
    fit = actions.add_parser("fit", help=text, description=text)
    fit.set_defaults(command=_suppress("fit"))
    fit.add_argument("--queries", type=Path, required=True, metavar="FILE", help=".npy, .npz, .safetensors or .h5")
    fit.add_argument("--database", type=Path, required=True, metavar="FILE", help="the same of the database")
    fit.add_argument("--method", choices=("INLP", "LEACE", "STD"), default="LEACE", help="(default: LEACE)")
    fit.add_argument("--seed", type=int, default=0, help="seed of INLP (default: 0)")
    fit.add_argument("--save", type=Path, required=True, metavar="FILE.npz", help="where to write it")
    text = "apply a saved transform to descriptors"
    apply = actions.add_parser("apply", help=text, description=text)
    apply.set_defaults(command=_suppress("apply"))
    apply.add_argument("transform", type=Path, metavar="FILE.npz")
    apply.add_argument("descriptors", type=Path, metavar="FILE")
    apply.add_argument("out", type=Path, metavar="OUT.npy")
    apply.add_argument("--condition", choices=("query", "database"), help="of the descriptors; STD needs it")


def _suppress(action: str) -> Callable[[argparse.Namespace], None]:
    def run(options: argparse.Namespace) -> None:
        from artifact.commands import suppress

        _print(getattr(suppress, action)(options))

    return run


def _add(options: argparse.Namespace) -> None:
    from artifact.commands import add

    _print(add.run(_manifest(options), options))


def _manifest(options: argparse.Namespace, *, make: bool = True) -> Any:
    """Load the manifest as the profile sees it; ``make`` writes made descriptors that are missing."""
    from artifact import manifest
    from artifact.extraction import made

    loaded = manifest.load(options.manifest)
    profile = getattr(options, "profile", None)
    if profile is None or not loaded.profile(profile).made:
        return loaded
    loaded = loaded.for_profile(profile)
    if make:
        made.make(loaded, profile)
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


def _run(options: argparse.Namespace) -> None:
    from artifact.book import build, runner, status

    manifest = _manifest(options)
    tasks = runner.plan(
        manifest,
        options.profile,
        only=options.only,
        asked=asked_parameters([*options.parameter, *assignments(options.set)]),
    )
    with build.timed() as preparation:
        runner.prepare(manifest, tasks)
    outcomes = runner.run(manifest, tasks, build.executed_folder(manifest), jobs=options.jobs, force=options.force)
    status.record_run(manifest, options.profile, tasks, outcomes, preparation.seconds)
    ran = [outcome for outcome in outcomes if not outcome.cached]
    sys.stdout.write(f"notebooks: {len(ran)} run, {len(outcomes) - len(ran)} unchanged\n")


def _reproduce(options: argparse.Namespace) -> None:
    _run(options)
    _book(options)


def _book(options: argparse.Namespace) -> None:
    from artifact.book import build

    manifest = _manifest(options)
    built, seconds = build.build(manifest)
    what = f"built in {seconds:.0f} s" if seconds is not None else "unchanged"
    sys.stdout.write(f"book: {what}; open {built}\n")


def _data(options: argparse.Namespace) -> int:
    from artifact import datasets
    from artifact.book import runner

    manifest = _manifest(options)
    missing = 0
    for name in manifest.profile(options.profile).datasets:
        try:
            traversals = runner.load_all(manifest, name)
        except datasets.DatasetError as error:
            missing += 1
            sys.stdout.write(f"{name}: missing\n{error}\n")
            continue
        for traversal in traversals:
            state = str(traversal.folder) if traversal.folder else "shipped descriptors only"
            sys.stdout.write(f"{name}/{traversal.name}: {len(traversal)} images, {state}\n")
    missing += _fetch_weights(manifest, options.profile)
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
    from artifact.commands import plan, ship
    from artifact.extraction import extract
    from artifact.methods import weights

    manifest = _manifest(options)
    profile = manifest.profile(options.profile)
    if options.ship:
        for path in ship.ship(manifest, options.ship, profile.methods):
            sys.stdout.write(f"{path}\n")
        return
    if options.dry_run:
        _print(plan.lines(manifest, options.profile, device=options.devices, precision=options.precision))
        return
    traversals = [traversal for name in profile.datasets for traversal in runner.load_all(manifest, name)]
    weights.require({name: manifest.method(name) for name in profile.methods})
    extract.check_disk(manifest, traversals, profile.methods)
    for traversal in traversals:
        for method in profile.methods:
            found = extract.descriptors(
                manifest, traversal, method, device=options.devices, precision=options.precision, progress=True
            )
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
    own = [name for name in options.datasets or [] if name not in manifest.datasets]
    for name in own:
        sys.stdout.write(f"{name}: {preview.in_words(preview.pair_facts(manifest, name))}\n")
        sys.stdout.write(preview.traversals_table(manifest, name).to_string(index=False, na_rep="–") + "\n")
        sys.stdout.write("".join(f"warning: {remark}\n" for remark in preview.remarks(manifest, name)) + "\n")
    for k in options.k or [1]:
        study = recall.recall_table(
            manifest, options.datasets or profile.datasets, options.methods or profile.methods, k=k
        )
        shown = study.table[["title", "method", "R", "DAR", "RSR", "queries", "origin"]]
        heading = f"K = {k}\n" if len(options.k) > 1 else ""
        sys.stdout.write(heading + shown.to_string(index=False, float_format=lambda value: f"{value:.2f}") + "\n")


def _verify(options: argparse.Namespace) -> int:
    from artifact.commands import verify

    lines, faults = verify.verify(_manifest(options), options.profile)
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    return 1 if faults else 0


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
    from artifact.commands import plan

    _print(plan.run_lines(_manifest(options), options.profile, device=options.devices))


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
    for line in status.status_lines(manifest, options.profile):
        sys.stdout.write(f"{line}\n")
