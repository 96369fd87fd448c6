"""What the command line takes: the commands, their options, and the text of their help."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from artifact import __version__

_PURPOSE = "Recompute every table and figure of the paper on distractor-augmented recall, or evaluate own data."
_EPILOG = "The Makefile calls these commands; `make help` lists them. See README.md for what each costs."


def parser() -> argparse.ArgumentParser:
    """Return what reads the command line; ``command`` names the command in what it reads, such as ``data add``."""
    whole = argparse.ArgumentParser(prog="artifact", description=_PURPOSE, epilog=_EPILOG)
    whole.add_argument("--version", action="version", version=f"artifact {__version__}")
    commands = whole.add_subparsers(required=True, metavar="command")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        sub = _action(commands, name, text)
        sub.add_argument("--manifest", type=Path, help="manifest file (default: the nearest data_manifest.yaml)")
        sub.add_argument("--trust", action="store_true", help="run the builders that a manifest from elsewhere names")
        return sub

    def scoped(name: str, text: str) -> argparse.ArgumentParser:
        sub = command(name, text)
        sub.add_argument("--profile", default="demo", help="profile of the manifest (default: demo)")
        return sub

    text = "make datasets and descriptors ready, run the notebooks, build the book"
    _run_options(scoped("reproduce", text))
    _run_options(scoped("run", "as reproduce, without building the book"))
    command("book", "build the book from the executed notebooks, running none")
    text = "make the datasets and weights of a profile ready and say which are missing"
    _data_options(scoped("data", text))
    _extract_options(scoped("extract", "extract the descriptors of a profile"))
    _evaluate_options(scoped("evaluate", "print R@K, DAR@K and RSR@K of datasets and methods"))
    _suppress_commands(command)
    _results_commands(command)
    text = "check stored results against their records and measurements against the paper"
    sub = scoped("verify", text)
    text = "delete what is damaged and all that was made from it, and make it again"
    sub.add_argument("--repair", action="store_true", help=text)
    text = "compute this anew from images, and compare with what is stored"
    sub.add_argument("--recompute", metavar="'DATASET x METHOD'", help=text)
    text = "time the ranking pass against a bare matrix product, and extraction against the model"
    sub = command("bench", text)
    text = "time these methods instead (default: the paper's), for Table II"
    sub.add_argument("--methods", nargs="*", metavar="METHOD", help=text)
    text = "say what a whole run takes on this machine: time, memory and disk of every step"
    _plan_options(scoped("plan", text))
    scoped("status", "show the state of data, descriptors and the last run")
    command("cluster-example", "write cluster.yaml, options of queueing systems to fill in")
    return whole


def _action(commands: Any, name: str, text: str) -> argparse.ArgumentParser:
    sub = commands.add_parser(name, help=text, description=text)
    sub.set_defaults(command=sub.prog.removeprefix("artifact "))
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
    _action(actions, "status", text)
    add = _action(actions, "add", "describe folders of images as a dataset, after a look at them")
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
    sub = command("results", "pass results on, or read those of others")
    actions = sub.add_subparsers(required=True, metavar="action")
    text = "write the results that the pages of a profile read into one file"
    export = _action(actions, "export", text)
    export.add_argument("file", type=Path, metavar="FILE.zip")
    export.add_argument("--profile", default="paper", help="profile of the manifest (default: paper)")
    text = "check such a file and read it, so that reproduce builds the book from it"
    reading = _action(actions, "import", text)
    reading.add_argument("file", type=Path, metavar="FILE.zip")


def _suppress_commands(command: Callable[..., argparse.ArgumentParser]) -> None:
    sub = command("suppress", "fit a suppression transform on descriptors in files, or apply one")
    actions = sub.add_subparsers(required=True, metavar="action")
    text = "fit on the descriptors of two conditions and save the transform"
    fit = _action(actions, "fit", text)
    fit.add_argument("--queries", type=Path, required=True, metavar="FILE", help=".npy, .npz, .safetensors or .h5")
    fit.add_argument("--database", type=Path, required=True, metavar="FILE", help="the same of the database")
    fit.add_argument("--method", choices=("INLP", "LEACE", "STD"), default="LEACE", help="(default: LEACE)")
    fit.add_argument("--seed", type=int, default=0, help="seed of INLP (default: 0)")
    fit.add_argument("--save", type=Path, required=True, metavar="FILE.npz", help="where to write it")
    apply = _action(actions, "apply", "apply a saved transform to descriptors")
    apply.add_argument("transform", type=Path, metavar="FILE.npz")
    apply.add_argument("descriptors", type=Path, metavar="FILE")
    apply.add_argument("out", type=Path, metavar="OUT.npy")
    apply.add_argument("--condition", choices=("query", "database"), help="of the descriptors; STD needs it")


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
