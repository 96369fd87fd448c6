"""Files of trained weights → tensors by name, without ever running what a file holds.

A checkpoint comes from somebody else's server. It is read with PyTorch's restricted reader (``weights_only=True``) or
as safetensors; a file that would need anything else is refused with the names that it asks for.
"""

from __future__ import annotations

import hashlib
import math
import pickle
import re
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file

from artifact.datasets.download import looks_like_page

_LISTED = 20
_CONTAINERS = {"state_dict": "under the key 'state_dict'", "model_state_dict": "under the key 'model_state_dict'"}
_PLACES = {**_CONTAINERS, "flat": "at the top level"}
_PREFIX = "module."  # put before every name by torch.nn.DataParallel
_REFUSED = "is refused, because reading it could run code: it asks for"

# What trainers store beside the weights (settings, paths, scores). Nothing of these packages is imported: an inert
# object takes the place of each, and none is used.
_BOOKKEEPING = ("pytorch_lightning", "lightning", "lightning_fabric", "omegaconf", "argparse", "pathlib", "numpy")


class CheckpointError(RuntimeError):
    """A file that holds no weights, holds more than data, or does not fit the model."""


def read(path: Path, *, container: str | None = None, tensor: str | None = None) -> dict[str, torch.Tensor]:
    """Read the weights of a checkpoint into memory, on the CPU; a leading ``module.`` of all names is removed.

    The format is recognised by the content: safetensors, or a file of ``torch.save`` in either of its forms.

    Parameters
    ----------
    container
        ``"state_dict"`` or ``"model_state_dict"`` if the weights must be under that key of the checkpoint, ``"flat"``
        if they must not be under any, ``None`` to take what is found.
    tensor
        Name for the only tensor of a file that is one tensor.

    Raises
    ------
    CheckpointError
        If the file is a web page, damaged, needs code to be read, or is not laid out as asked.
    """
    content = _content(path)
    if tensor is not None:
        if not isinstance(content, torch.Tensor):
            raise CheckpointError(f"holds an object of type {type(content).__name__}; a single tensor is expected")
        return _tensors({tensor: content}, path)
    if not isinstance(content, Mapping):
        kind = type(content).__name__
        raise CheckpointError(f"holds an object of type {kind}; a mapping from names to tensors is expected")
    found = next((key for key in _CONTAINERS if isinstance(content.get(key), Mapping)), "flat")
    if container not in (None, found):
        raise CheckpointError(f"has its weights {_PLACES[found]}; the released file has them {_PLACES[container]}")
    tensors = _tensors(content if found == "flat" else content[found], path)
    strip = len(_PREFIX) if all(name.startswith(_PREFIX) for name in tensors) else 0
    return {name[strip:]: value for name, value in tensors.items()}


def _tensors(state: Mapping[Any, Any], path: Path) -> dict[str, torch.Tensor]:
    """Return the entries of a mapping, detached, if all are plain tensors that the file has room for."""
    odd = [str(name) for name, value in state.items() if not (isinstance(name, str) and _is_plain(value))]
    if odd or not state:
        raise CheckpointError(f"holds no weights, but entries such as {_listed(odd)}" if odd else "holds no weights")
    room = path.stat().st_size
    for name, value in state.items():  # a stride of 0 makes any size of one number
        if (claimed := math.prod(value.shape) * value.element_size()) > room:
            raise CheckpointError(f"is refused: {name} claims {claimed:,} bytes in a file of {room:,}")
    return {name: value.detach() for name, value in state.items()}


def _is_plain(value: Any) -> bool:
    if not isinstance(value, torch.Tensor) or value.is_nested or value.is_quantized:
        return False
    return value.device.type == "cpu" and value.layout is torch.strided


def _content(path: Path) -> Any:
    try:
        with path.open("rb") as stream:
            head = stream.read(512)
        if looks_like_page(head):
            raise CheckpointError("is a web page, saved in place of the file")
        if head[8:9] == b"{" and int.from_bytes(head[:8], "little") <= path.stat().st_size - 8:
            return load_file(path)
        with torch.serialization.safe_globals([(_stand_in(name), name) for name in _foreign_names(path)]):
            return torch.load(path, map_location="cpu", weights_only=True)
    except (CheckpointError, MemoryError):
        raise
    except Exception as error:  # a hostile file can make the readers fail in any way
        asked = re.search(r"GLOBAL (\S+)", str(error)) if isinstance(error, pickle.UnpicklingError) else None
        if asked:
            raise CheckpointError(f"{_REFUSED} {asked[1]}") from None
        reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0].strip()}"
        raise CheckpointError(f"cannot be read ({reason}): the file is damaged, incomplete or no checkpoint") from None


def _foreign_names(path: Path) -> list[str]:
    """Return the names of trainers' bookkeeping that a checkpoint refers to, or refuse it for any other name."""
    try:
        names = sorted(torch.serialization.get_unsafe_globals_in_checkpoint(path))
    except Exception:  # not of the zip form, or the list cannot be made: then no name at all is allowed
        return []
    refused = [name for name in names if name.split(".", 1)[0] not in _BOOKKEEPING]
    if refused:
        raise CheckpointError(f"{_REFUSED} {_listed(refused)}")
    return names


class _Inert:
    """Takes the place of an object that is not needed; whatever it is given, it does nothing."""

    def __new__(cls, *_: Any) -> _Inert:
        return super().__new__(cls)

    def __setstate__(self, _: Any) -> None:
        pass


def _stand_in(name: str) -> type:
    return OrderedDict if name.endswith(("Dict", "DictConfig")) else _Inert  # the reader fills mappings only


def faults(state: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]) -> list[str]:
    """Compare weights with those that a model needs: a line each, with the first 20 names, for the kinds of difference.

    Examples
    --------
    >>> faults({"a": torch.zeros(2), "c": torch.zeros(1)}, {"a": torch.zeros(3), "b": torch.zeros(1)})
    ['1 missing: b', '1 unexpected: c', '1 of another shape: a (2) for (3)']
    """
    both = [(name, state[name], tensor) for name, tensor in expected.items() if name in state]
    retyped = [(name, a, b) for name, a, b in both if a.is_floating_point() != b.is_floating_point()]
    differing = {
        "missing": [name for name in expected if name not in state],
        "unexpected": [name for name in state if name not in expected],
        "of another shape": [f"{name} {_shape(a)} for {_shape(b)}" for name, a, b in both if a.shape != b.shape],
        "of another type": [f"{name} {a.dtype} for {b.dtype}" for name, a, b in retyped],
    }
    return [f"{len(items)} {what}: {_listed(items)}" for what, items in differing.items() if items]


def load_into(model: torch.nn.Module, state: Mapping[str, torch.Tensor]) -> torch.nn.Module:
    """Give a model its weights, what :func:`read` returned for all files of the method: all of them, and nothing else.

    Floats are converted to the model's precision. A model on the meta device takes over the tensors, and nothing is
    copied. Raises :class:`CheckpointError` with the lines of :func:`faults` if the weights do not fit.
    """
    expected = model.state_dict()
    if found := faults(state, expected):
        raise CheckpointError("\n    ".join(["does not fit the model:", *found]))
    fitted = {name: state[name].to(tensor.dtype).contiguous() for name, tensor in expected.items()}
    model.load_state_dict(fitted, strict=True, assign=any(tensor.is_meta for tensor in expected.values()))
    return model.eval().requires_grad_(False)


def digest(state: Mapping[str, torch.Tensor]) -> str:
    """Return the SHA-256 of names, shapes, types and values: equal for equal weights, however they are packed."""
    total = hashlib.sha256()
    for name, value in sorted(state.items()):
        total.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        total.update(value.contiguous().reshape(-1).view(torch.uint8).numpy().data)
    return total.hexdigest()


def _listed(names: Sequence[str]) -> str:
    more = f", and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def _shape(tensor: torch.Tensor) -> str:
    return f"({', '.join(map(str, tensor.shape))})"
