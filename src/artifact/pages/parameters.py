"""What each notebook parameter may be: checked before a run, and again at the top of the notebook itself.

Papermill only logs an unknown parameter and runs on with the default. Here an unknown name, a wrong type or a value outside its
range is an error that names the parameter, the value and what is allowed.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from IPython import get_ipython

from artifact.datasets import DatasetError
from artifact.datasets.appearance import STATISTICS
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, quoted


class ParameterError(ValueError):
    """Parameters that a notebook cannot run with; every fault is listed."""


def settled(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters with one name, or several with commas, as a list of names.

    Examples
    --------
    >>> settled({"methods": "salad, boq", "k": 5})
    {'methods': ['salad', 'boq'], 'k': 5}
    """

    def names(name: str, value: Any) -> Any:
        if name not in ("datasets", "methods") or not isinstance(value, str):
            return value
        return [value] if Path(value).is_dir() else [part.strip() for part in value.split(",") if part.strip()]

    return {name: names(name, value) for name, value in values.items()}


def faults(values: Mapping[str, Any], manifest: Manifest, defaults: Mapping[str, Any] | None = None) -> list[str]:
    """Say what is wrong with each value, if anything; other parameters are held to the type of their default."""
    found = []
    for name, value in values.items():
        check = _CHECKS.get(name) or (_same_type(defaults[name]) if defaults else None)
        if check and (fault := check(value, manifest)):
            found.append(f"{name} is {value!r}; {fault}")
    return found


def unknown(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Say which names are none of the known parameters."""
    known = list(known)
    return [f"unknown parameter {name!r}; allowed: {', '.join(known) or 'none'}" for name in names if name not in known]


def injected() -> list[str]:
    """Return the names that papermill set in the notebook that runs, if it runs in one."""
    shell = get_ipython()
    cells = [] if shell is None else [cell for cell in shell.user_ns.get("In", []) if cell.startswith("# Parameters\n")]
    return [
        ast.unparse(one.targets[0]) for cell in cells for one in ast.parse(cell).body if isinstance(one, ast.Assign)
    ]


# -- what each parameter may be: a check returns what is allowed, or nothing if the value is good --------------------

_Check = Callable[[Any, Manifest], str | None]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == value  # noqa: PLR0124


def _if(good: Callable[[Any], bool], allowed: str) -> _Check:
    return lambda value, _: None if good(value) else f"allowed: {allowed}"


def _integer(lowest: int) -> _Check:
    return _if(lambda value: type(value) is int and value >= lowest, f"whole numbers from {lowest}")


def _list_of(good: Callable[[Any], bool], what: str) -> _Check:
    return _if(lambda value: isinstance(value, list) and bool(value) and all(map(good, value)), f"a list of {what}")


def _is_share(value: Any) -> bool:
    return _is_number(value) and 0 <= value <= 1


def _one_of(names: Iterable[str], value: Any) -> str | None:
    return None if value in tuple(names) else f"allowed: {quoted(names)}"


def _one_dataset(value: Any, manifest: Manifest) -> str | None:
    allowed = f"allowed: {quoted(manifest.datasets)}, or the path of a folder"
    if not isinstance(value, str):
        return allowed
    try:
        manifest.dataset(value)
    except (DatasetError, ManifestError) as error:
        return str(error) if Path(value).expanduser().is_dir() else allowed
    return None


def _several(check: _Check) -> _Check:
    def checked(value: Any, manifest: Manifest) -> str | None:
        if not isinstance(value, list) or not value:
            return "allowed: one name, several with commas, a list of names, or None for all of the profile"
        return next((f"{item!r}: {fault}" for item in value if (fault := check(item, manifest))), None)

    return _optional(checked)


def _optional(check: _Check) -> _Check:
    return lambda value, manifest: None if value is None else check(value, manifest)


def _same_type(default: Any) -> _Check:
    """Accept values of the type of the default; a whole number is a number."""

    def good(value: Any) -> bool:
        return default is None or type(value) is type(default) or (isinstance(default, float) and _is_number(value))

    return _if(good, f"a value of type {type(default).__name__}, as the default {default!r}")


_CHECKS: dict[str, _Check] = {
    "profile": lambda value, manifest: _one_of(manifest.profiles, value),
    "dataset": _optional(_one_dataset),
    "datasets": _several(_one_dataset),
    "method": _optional(lambda value, manifest: _one_of(manifest.methods, value)),
    "methods": _several(lambda value, manifest: _one_of(manifest.methods, value)),
    "seed": _integer(0),
    "similarity": lambda value, _: _one_of(("cosine", "l2", "dot"), value),
    "distances": _list_of(lambda value: _is_number(value) and value >= 0, "numbers from 0 to inf"),
    "statistics": _list_of(STATISTICS.__contains__, quoted(STATISTICS)),
    **dict.fromkeys(("fraction", "share"), _if(_is_share, "a number from 0 to 1")),
    **dict.fromkeys(("fractions", "ratios"), _list_of(_is_share, "numbers from 0 to 1")),
    **dict.fromkeys(("k", "iterations", "draws", "places", "most"), _integer(1)),
    **dict.fromkeys(("n_queries", "n_database", "dimension", "n_views"), _integer(1)),
}
