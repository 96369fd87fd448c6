"""Files of trained weights → tensors by name, without ever running what a file holds.

A checkpoint comes from somebody else's server. It is read with PyTorch's restricted reader (``weights_only=True``) or
as safetensors; a file that would need anything else is refused with the names that it asks for.
"""

from __future__ import annotations

import hashlib
import pickle
import re
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from artifact.methods.weights.download import looks_like_page

_LISTED = 20
_CONTAINERS = ("state_dict", "model_state_dict")
_PREFIX = "module."  # put before every name by torch.nn.DataParallel
_INTACT = "the file is damaged, incomplete or no checkpoint"
_REFUSED = "is refused, because reading it could run code"

# What trainers store beside the weights (settings, paths, scores). Nothing of these packages is imported: an inert
# object takes the place of each, and none is used.
_BOOKKEEPING = ("pytorch_lightning", "lightning", "lightning_fabric", "omegaconf", "argparse", "pathlib", "numpy")


class CheckpointError(RuntimeError):
    """A file that holds no weights, holds more than data, or does not fit the model."""


def read(path: Path, *, container: str | None = None, tensor: str | None = None) -> dict[str, torch.Tensor]:
    """Read the weights of a checkpoint into memory, on the CPU.

    The format is recognised by the content: safetensors, or a file of ``torch.save`` in either of its forms. A leading
    ``module.`` is removed where all names have it.

    Parameters
    ----------
    path
        The file.
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
        if not _is_plain(content):
            raise CheckpointError(f"holds {_kind(content)}; a single tensor is expected")
        return {tensor: content.detach()}
    if not isinstance(content, Mapping):
        raise CheckpointError(f"holds {_kind(content)}; a mapping from names to tensors is expected")
    found = next((key for key in _CONTAINERS if isinstance(content.get(key), Mapping)), "flat")
    if container is not None and found != container:
        places = {key: f"under the key {key!r}" for key in _CONTAINERS} | {"flat": "at the top level"}
        raise CheckpointError(f"has its weights {places[found]}; the released file has them {places[container]}")
    return _named(content if found == "flat" else content[found])


def _named(state: Mapping[Any, Any]) -> dict[str, torch.Tensor]:
    odd = [str(key) for key, value in state.items() if not (isinstance(key, str) and _is_plain(value))]
    if odd or not state:
        raise CheckpointError(f"holds no weights, but entries such as {_listed(odd)}" if odd else "holds no weights")
    strip = len(_PREFIX) if all(key.startswith(_PREFIX) for key in state) else 0
    return {key[strip:]: value.detach() for key, value in state.items()}


def _is_plain(value: Any) -> bool:
    return (
        isinstance(value, torch.Tensor)
        and value.device.type == "cpu"
        and value.layout is torch.strided
        and not value.is_quantized
    )


def _kind(content: Any) -> str:
    return f"an object of type {type(content).__name__}"


# -- reading without running -----------------------------------------------------------------------------------------


def _content(path: Path) -> Any:
    with path.open("rb") as stream:
        head = stream.read(512)
    if looks_like_page(head):
        raise CheckpointError("is a web page, saved in place of the file")
    try:
        if _is_safetensors(head, path.stat().st_size):
            return load_file(path)
        with torch.serialization.safe_globals([(_stand_in(name), name) for name in _foreign_names(path)]):
            return torch.load(path, map_location="cpu", weights_only=True)
    except (CheckpointError, MemoryError):
        raise
    except SafetensorError as error:
        raise CheckpointError(f"cannot be read ({error}): {_INTACT}") from None
    except Exception as error:  # a hostile file can make the reader fail in any way
        asked = re.search(r"GLOBAL (\S+)", str(error)) if isinstance(error, pickle.UnpicklingError) else None
        if asked:
            raise CheckpointError(f"{_REFUSED}: it asks for {asked[1]}") from None
        raise CheckpointError(f"cannot be read ({type(error).__name__}: {_first_line(error)}): {_INTACT}") from None


def _is_safetensors(head: bytes, size: int) -> bool:
    return head[8:9] == b"{" and int.from_bytes(head[:8], "little") <= size - 8


def _foreign_names(path: Path) -> list[str]:
    """Return the names of trainers' bookkeeping that a checkpoint refers to, or refuse it for any other name."""
    try:
        names = sorted(torch.serialization.get_unsafe_globals_in_checkpoint(path))
    except Exception:  # not of the zip form, or the list cannot be made: then no name at all is allowed
        return []
    refused = [name for name in names if name.split(".", 1)[0] not in _BOOKKEEPING]
    if refused:
        raise CheckpointError(f"{_REFUSED}: it asks for {_listed(refused)}")
    return names


class _Inert:
    """Takes the place of an object that is not needed; whatever it is given, it does nothing."""

    def __init__(self, *_: Any) -> None:
        pass

    def __new__(cls, *_: Any) -> _Inert:
        return super().__new__(cls)

    def __setstate__(self, _: Any) -> None:
        pass


def _stand_in(name: str) -> type:
    return OrderedDict if name.endswith(("Dict", "DictConfig")) else _Inert  # the reader fills mappings only


# -- fitting a model -------------------------------------------------------------------------------------------------


def faults(state: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]) -> list[str]:
    """Compare weights with those that a model needs, by name, shape and kind of number.

    Returns
    -------
    list of str
        One line each for the missing, the unexpected and the misshaped, with their number and the first 20 names. Empty
        if all fit.

    Examples
    --------
    >>> faults({"a": torch.zeros(2), "c": torch.zeros(1)}, {"a": torch.zeros(3), "b": torch.zeros(1)})
    ['1 missing: b', '1 unexpected: c', '1 of another shape: a (2) for (3)']
    """
    missing = [key for key in expected if key not in state]
    unexpected = [key for key in state if key not in expected]
    both = [(key, state[key], tensor) for key, tensor in expected.items() if key in state]
    shapes = [f"{k} {_shape(a)} for {_shape(b)}" for k, a, b in both if a.shape != b.shape]
    kinds = [f"{k} {a.dtype} for {b.dtype}" for k, a, b in both if a.is_floating_point() != b.is_floating_point()]
    named = {"missing": missing, "unexpected": unexpected, "of another shape": shapes, "of another type": kinds}
    return [f"{len(items)} {what}: {_listed(items)}" for what, items in named.items() if items]


def load_into(model: torch.nn.Module, state: Mapping[str, torch.Tensor]) -> torch.nn.Module:
    """Give a model its weights: all of them, and nothing else.

    Parameters
    ----------
    model
        May be on the meta device: then it takes over the tensors, and nothing is copied.
    state
        What :func:`read` returned, for all files of the method. Floats are converted to the model's precision.

    Raises
    ------
    CheckpointError
        If the weights do not fit; the message has the lines of :func:`faults`.
    """
    expected = model.state_dict()
    found = faults(state, expected)
    if found:
        raise CheckpointError("does not fit the model:\n    " + "\n    ".join(found))
    assign = any(tensor.is_meta for tensor in expected.values())
    fitted = {key: state[key].to(expected[key].dtype).contiguous() for key in expected}
    model.load_state_dict(fitted, strict=True, assign=assign)
    return model.eval().requires_grad_(False)


def digest(state: Mapping[str, torch.Tensor]) -> str:
    """Return the SHA-256 of names, shapes, types and values: equal for equal weights, however they are packed."""
    total = hashlib.sha256()
    for key in sorted(state):
        tensor = state[key].contiguous()
        total.update(f"{key} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        total.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return total.hexdigest()


def _listed(names: list[str]) -> str:
    more = f", and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def _shape(tensor: torch.Tensor) -> str:
    return f"({', '.join(map(str, tensor.shape))})"


def _first_line(error: Exception) -> str:
    return str(error).split("\n", 1)[0].strip()
