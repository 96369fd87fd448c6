"""YAML with line numbers, and faults in words."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from artifact.manifest.entries import Document, ManifestError, quoted

Model = TypeVar("Model", bound=BaseModel)


def read(path: Path, model: type[Model]) -> Model:
    """Read and check a YAML file, or raise :class:`ManifestError` that lists all faults with their lines."""
    try:
        root = _compose(path)
        return model.model_validate(_plain(root, path))
    except RecursionError:
        raise ManifestError(f"{path}: is nested too deep, or an alias in it refers to what it stands in") from None
    except ValidationError as error:
        raise ManifestError("\n".join(_explain(error, root, path, model))) from None


def _compose(path: Path) -> yaml.Node:
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        raise ManifestError(f"{path}{where}: not valid YAML: {getattr(error, 'problem', error)}") from None
    except UnicodeDecodeError as error:
        raise ManifestError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None
    if not isinstance(node, yaml.MappingNode):
        allowed = f"a mapping with the keys {quoted(Document.model_fields)}"
        raise ManifestError(f"{path}: found an empty or plain document; allowed: {allowed}")
    return node


def _plain(node: yaml.Node, path: Path) -> Any:
    """Build plain Python values, refusing a key that is written twice (YAML would keep the last silently)."""
    if isinstance(node, yaml.MappingNode):
        lines: dict[Any, int] = {}
        result = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise ManifestError(f"{path}:{line}: found a list or mapping as a key; allowed: plain text, numbers")
            key = _plain(key_node, path)
            if key in lines:
                raise ManifestError(f"{path}:{line}: the key {key!r} is already on line {lines[key]}")
            lines[key], result[key] = line, _plain(value_node, path)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, path) for item in node.value]
    try:
        return yaml.SafeLoader("").construct_object(node)
    except (yaml.YAMLError, ValueError):  # ValueError: a date that no calendar has
        found = f"{path}:{node.start_mark.line + 1}: found {node.value!r} with the tag {node.tag}"
        raise ManifestError(f"{found}; allowed: plain text, numbers, true, false, null") from None


def _line(root: yaml.Node, location: tuple[Any, ...]) -> int:
    """Line of the deepest node on a key path that exists in the file."""
    node, line = root, root.start_mark.line + 1
    for part in location:
        if isinstance(node, yaml.MappingNode):
            child = next(((k, v) for k, v in node.value if k.value == str(part)), None)
            if child is None:
                break
            line, node = child[0].start_mark.line + 1, child[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            break
    return line


def _explain(error: ValidationError, root: yaml.Node, path: Path, model: type[BaseModel]) -> Iterator[str]:
    for fault in error.errors():
        location = tuple(part for part in fault["loc"] if part != "[key]")
        where = f"{path}:{_line(root, location)}: {'.'.join(map(str, location)) or 'manifest'}"
        match fault["type"]:
            case "extra_forbidden":
                yield f"{where}: unknown key; allowed: {quoted(_fields_at(model, location[:-1]))}"
            case "missing":
                yield f"{where}: this key is missing"
            case "literal_error":
                yield f"{where}: found {fault['input']!r}; allowed: {fault['ctx']['expected']}"
            case "value_error":
                yield f"{where}: {fault['ctx']['error']}"
            case _:
                found = fault["input"] if not isinstance(fault["input"], dict) else "a mapping"
                yield f"{where}: found {found!r}; {fault['msg'][0].lower()}{fault['msg'][1:]}"


def _fields_at(model: type[BaseModel], location: tuple[Any, ...]) -> list[str]:
    """Names of the keys that are allowed in the mapping at a key path, read off the models' annotations."""
    annotation: Any = model
    for part in location:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            annotation = annotation.model_fields[str(part)].annotation
        else:
            annotation = get_args(annotation)[-1]
        if get_origin(annotation) in (Union, UnionType):
            models = (a for a in get_args(annotation) if isinstance(a, type) and issubclass(a, BaseModel))
            annotation = next(models, annotation)
    return list(annotation.model_fields)
