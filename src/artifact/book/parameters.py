"""Notebook parameters: read from the notebook, merged with what a run asks for, checked before anything runs.

Papermill only logs an unknown parameter and runs on with the default. Here an unknown name, a wrong type or a value
outside its range is an error that names the notebook, the parameter, the value and what is allowed.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jupytext

from artifact.datasets import DatasetError
from artifact.datasets.appearance import STATISTICS
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError


class ParameterError(ValueError):
    """Parameters that a notebook cannot run with; every fault is listed."""


def read(notebook: Path) -> dict[str, Any]:
    """Return the parameters of a notebook with their defaults.

    They are the plain assignments of literals in the one cell that is tagged ``parameters``.

    Raises
    ------
    ParameterError
        If there is no such cell, more than one, or it holds anything but ``name = literal``.
    """
    cells = [c for c in jupytext.read(notebook).cells if "parameters" in c.metadata.get("tags", [])]
    if len(cells) != 1:
        raise ParameterError(f"{notebook}: {len(cells)} cells are tagged 'parameters'; allowed: exactly one")
    defaults = {}
    for statement in ast.parse(cells[0].source).body:
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            continue  # a docstring-like comment
        if (
            not isinstance(statement, ast.Assign)
            or len(statement.targets) != 1
            or not isinstance(statement.targets[0], ast.Name)
        ):
            raise ParameterError(f"{notebook}: line {statement.lineno} of the parameters cell is not 'name = literal'")
        name = statement.targets[0].id
        try:
            defaults[name] = ast.literal_eval(statement.value)
        except ValueError:
            raise ParameterError(f"{notebook}: the default of {name!r} is not a literal") from None
    return defaults


def merged(notebook: Path, asked: Mapping[str, Any], manifest: Manifest) -> dict[str, Any]:
    """Return a notebook's parameters with the asked values in place of defaults, all checked.

    Raises
    ------
    ParameterError
        If a name is unknown or a value is not allowed; all faults at once.
    """
    defaults = read(notebook)
    faults = [
        f"unknown parameter {name!r}; allowed: {', '.join(defaults) or 'none'}"
        for name in asked
        if name not in defaults
    ]
    values = {**defaults, **{name: value for name, value in asked.items() if name in defaults}}
    for name, value in values.items():
        check = _CHECKS.get(name, _same_type(defaults[name]))
        fault = check(value, manifest)
        if fault:
            faults.append(f"{name} is {value!r}; {fault}")
    if faults:
        raise ParameterError("\n".join(f"notebooks/{notebook.name}: {fault}" for fault in faults))
    return values


# -- what each parameter may be: a check returns what is allowed, or nothing if the value is good --------------------

_Check = Callable[[Any, Manifest], str | None]


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == value  # noqa: PLR0124


def _integer(lowest: int) -> _Check:
    def check(value: Any, _: Manifest) -> str | None:
        return None if _is_integer(value) and value >= lowest else f"allowed: whole numbers from {lowest}"

    return check


def _numbers(low: float, high: float) -> _Check:
    def check(value: Any, _: Manifest) -> str | None:
        good = isinstance(value, list) and value and all(_is_number(item) and low <= item <= high for item in value)
        return None if good else f"allowed: a list of numbers from {low:g} to {high:g}"

    return check


def _number(low: float, high: float) -> _Check:
    def check(value: Any, _: Manifest) -> str | None:
        return None if _is_number(value) and low <= value <= high else f"allowed: a number from {low:g} to {high:g}"

    return check


def _profile(value: Any, manifest: Manifest) -> str | None:
    return None if value in manifest.profiles else f"allowed: {_quoted(manifest.profiles)}"


def _one_dataset(value: Any, manifest: Manifest) -> str | None:
    allowed = f"allowed: {_quoted(manifest.datasets)}, or the path of a folder"
    if not isinstance(value, str):
        return allowed
    try:
        manifest.dataset(value)
    except (DatasetError, ManifestError) as error:
        return str(error) if Path(value).expanduser().is_dir() else allowed
    return None


def _one_method(value: Any, manifest: Manifest) -> str | None:
    return None if value in manifest.methods else f"allowed: {_quoted(manifest.methods)}"


def _several(check: _Check) -> _Check:
    def checked(value: Any, manifest: Manifest) -> str | None:
        if value is None:
            return None
        if not isinstance(value, list) or not value:
            return "allowed: a list of names, or None for all of the profile"
        return next((f"{item!r}: {fault}" for item in value if (fault := check(item, manifest))), None)

    return checked


def _optional(check: _Check) -> _Check:
    return lambda value, manifest: None if value is None else check(value, manifest)


def _similarity(value: Any, _: Manifest) -> str | None:
    return None if value in ("cosine", "l2", "dot") else "allowed: 'cosine', 'l2', 'dot'"


def _statistics(value: Any, _: Manifest) -> str | None:
    good = isinstance(value, list) and value and all(item in STATISTICS for item in value)
    return None if good else f"allowed: a list of {_quoted(STATISTICS)}"


def _same_type(default: Any) -> _Check:
    """Accept values of the type of the default; a whole number is a number."""

    def check(value: Any, _: Manifest) -> str | None:
        if default is None or type(value) is type(default) or (isinstance(default, float) and _is_number(value)):
            return None
        return f"allowed: a value of type {type(default).__name__}, as the default {default!r}"

    return check


def _quoted(names: Any) -> str:
    return ", ".join(repr(name) for name in names)


_CHECKS: dict[str, _Check] = {
    "profile": _profile,
    "dataset": _optional(_one_dataset),
    "datasets": _several(_one_dataset),
    "method": _optional(_one_method),
    "methods": _several(_one_method),
    "k": _integer(1),
    "seed": _integer(0),
    "similarity": _similarity,
    "ratios": _numbers(0, 1),
    "distances": _numbers(0, float("inf")),
    "fraction": _number(0, 1),
    "fractions": _numbers(0, 1),
    "share": _number(0, 1),
    "iterations": _integer(1),
    "draws": _integer(1),
    "statistics": _statistics,
}
