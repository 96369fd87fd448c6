"""Notebook parameters: read from the notebook, merged with what a run asks for, checked before anything runs."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jupytext

from artifact.manifest import Manifest
from artifact.pages.parameters import ParameterError, faults, settled, unknown


def read(notebook: Path) -> dict[str, Any]:
    """Return the parameters of a notebook with their defaults, the literals of the one cell tagged ``parameters``.

    Raises
    ------
    ParameterError
        If there is no such cell, more than one, or it holds anything but ``name: type = literal``.
    """
    cells = [c for c in jupytext.read(notebook).cells if "parameters" in c.metadata.get("tags", [])]
    if len(cells) != 1:
        raise ParameterError(f"{notebook}: {len(cells)} cells are tagged 'parameters'; allowed: exactly one")
    defaults = {}
    for statement in ast.parse(cells[0].source).body:
        match statement:
            case ast.Expr(ast.Constant()):
                continue  # a docstring-like comment
            case ast.Assign([ast.Name(name)], value) | ast.AnnAssign(ast.Name(name), _, ast.expr() as value):
                try:
                    defaults[name] = ast.literal_eval(value)
                except ValueError:
                    raise ParameterError(f"{notebook}: the default of {name!r} is not a literal") from None
            case _:
                at = f"{notebook}: line {statement.lineno} of the parameters cell"
                raise ParameterError(f"{at} is not 'name: type = literal'")
    return defaults


def merged(notebook: Path, asked: Mapping[str, Any], manifest: Manifest) -> dict[str, Any]:
    """Return a notebook's parameters with the asked values in place of defaults, all checked.

    Raises
    ------
    ParameterError
        If a name is unknown or a value is not allowed; all faults at once.
    """
    defaults = read(notebook)
    values = settled({name: asked.get(name, default) for name, default in defaults.items()})
    if found := [*unknown(asked, defaults), *faults(values, manifest, defaults)]:
        raise ParameterError("\n".join(f"notebooks/{notebook.name}: {fault}" for fault in found))
    return values
