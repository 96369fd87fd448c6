"""Descriptor models by name.

A model is a ``torch.nn.Module`` in eval mode: images ``(b, c, h, w)`` float32, already prepared as the method's
manifest entry says, to unit-length descriptors ``(b, d)`` float32. :func:`build` gives the architecture, :func:`load`
and :func:`model_of` the model with its released weights.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from artifact import manifest as manifests
from artifact import store
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, MethodEntry, WeightsFile
from artifact.methods import weights
from artifact.methods.weights import WeightsError

if TYPE_CHECKING:
    import torch
    from torch import nn

# The class of each model, or the function that makes it with weights. Raise a revision when the descriptors of that
# model change: it is part of the descriptors' content key. Modules are imported only when a model is built.
_BUILDERS: dict[str, tuple[str, int]] = {
    "thumbnail": ("artifact.methods.thumbnail:Thumbnail", 1),
    "hog": ("artifact.methods.hog:HOG", 1),
    "efficientnet_lite0": ("artifact.methods.efficientnet_lite:efficientnet_lite0", 2),
    "efficientnet_lite0_vlad": ("artifact.methods.efficientnet_lite:vlad", 1),
    "efficientnet_lite0_grid": ("artifact.methods.efficientnet_lite:grid", 1),
    "anyloc": ("artifact.methods.anyloc:AnyLoc", 1),
    "boq": ("artifact.methods.boq:BoQ", 1),
    "cosplace": ("artifact.methods.cosplace:CosPlace", 1),
    "cricavpr": ("artifact.methods.cricavpr:CricaVPR", 1),
    "eigenplaces": ("artifact.methods.cosplace:EigenPlaces", 1),
    "megaloc": ("artifact.methods.megaloc:MegaLoc", 1),
    "mixvpr": ("artifact.methods.mixvpr:MixVPR", 1),
    "salad": ("artifact.methods.salad:SALAD", 1),
    "salad_cm": ("artifact.methods.salad:SALAD", 1),
    "selavpr": ("artifact.methods.selavpr:SelaVPR", 1),
    "selavprpp": ("artifact.methods.selavprpp:SelaVPRPlusPlus", 1),
}


def names() -> list[str]:
    """Return the names that :func:`build` knows."""
    return list(_BUILDERS)


def build(name: str, **options: Any) -> nn.Module:
    """Build one of :func:`names` in eval mode, untrained but for baselines; raise ``KeyError`` for another name.

    ``options`` go to the model's constructor; ``seed`` is that of untrained weights.

    Examples
    --------
    >>> build("hog", orientations=6).orientations
    6
    """
    if name not in _BUILDERS:
        raise KeyError(f"no method {name!r}; the methods are {', '.join(_BUILDERS)}")
    from artifact.methods.blocks.untrained import untrained

    model = _function(_BUILDERS[name][0])
    return untrained(model, **options) if isinstance(model, type) else model(**options).eval()


def load(name: str, manifest: Manifest | None = None) -> nn.Module:
    """Return a method of the manifest, by default the nearest, with its released weights, verified, in eval mode.

    Raises
    ------
    ManifestError
        If the manifest has no such method.
    WeightsError
        If the weights are missing (the message says how to get them), have changed, or do not fit the model.

    Examples
    --------
    >>> type(load("hog")).__name__
    'HOG'
    """
    return model_of(name, (manifest or manifests.load()).method(name))


def model_of(name: str, entry: MethodEntry) -> nn.Module:
    """Return the model of a manifest entry: its ``builder``'s, or the library's of that name, with its weights.

    A method of the paper is never returned untrained.

    Raises
    ------
    ManifestError
        If the entry names no builder and the library has no such model, or the builder cannot be imported.
    WeightsError
        As of :func:`load`.
    """
    if entry.weights is None:
        if weights.is_required(entry):
            raise WeightsError(weights.state(name, entry).detail)
        return _untrained(name, entry)
    from artifact.methods.weights import checkpoints

    weights.require({name: entry})
    check = _check(name, entry)
    paths = [weights.verified(name, entry.weights, file, check) for file in entry.weights.files]
    state: dict[str, torch.Tensor] = {}
    try:
        for file, path in zip(entry.weights.files, paths, strict=True):
            state |= checkpoints.read(path, container=file.container, tensor=file.tensor)
        return checkpoints.load_into(_empty(name, entry), state)
    except checkpoints.CheckpointError as error:
        raise WeightsError(f"{name}: {', '.join(map(str, paths))} {error}") from None


def of_trunk(manifest: Manifest, name: str) -> dict[str, MethodEntry]:
    """Return the methods of a manifest that one pass describes images by: those of the same trunk, or one alone."""
    entry = manifest.method(name)
    if entry.trunk is None:
        return {name: entry}
    return {other: one for other, one in manifest.methods.items() if one.trunk == entry.trunk}


def shared(
    entries: Mapping[str, MethodEntry], device: torch.device
) -> Callable[[torch.Tensor], tuple[torch.Tensor, ...]]:
    """Return what gives, of images, the descriptors by each method of one trunk, in their order, on a device.

    Their models have ``maps(images)``, the same for all of them, and ``head(maps)``.
    """
    models = [model_of(name, entry).to(device) for name, entry in entries.items()]

    def descriptors(images: torch.Tensor) -> tuple[torch.Tensor, ...]:
        maps = models[0].maps(images)
        return tuple(model.head(maps) for model in models)

    return descriptors


def fetch(name: str, entry: MethodEntry, *, progress: bool = True) -> None:
    """Download and examine what is missing of a method's weights; see :func:`artifact.methods.weights.fetch`."""
    if entry.weights is not None:
        weights.fetch(name, entry.weights, _check(name, entry), progress=progress)
    elif weights.is_required(entry):
        raise WeightsError(weights.state(name, entry).detail)


def _check(name: str, entry: MethodEntry) -> weights.Check:
    """Ask whether a file of weights fits its part of the model: the tensor it names, or all that no other names."""

    def digest(file: WeightsFile, found: Path) -> str:
        from artifact.methods.weights import checkpoints

        others = {other.tensor for other in entry.weights.files if other.tensor} if entry.weights else set()
        try:
            state = checkpoints.read(found, container=file.container, tensor=file.tensor)
            model = _empty(name, entry).state_dict()
            part = {file.tensor} if file.tensor else model.keys() - others
            faults = checkpoints.faults(state, {key: value for key, value in model.items() if key in part})
        except checkpoints.CheckpointError as error:
            raise WeightsError(f"{file.file} {error}") from None
        if faults:
            raise WeightsError("\n    ".join([f"{file.file} does not fit the model", *faults]))
        return checkpoints.digest(state)

    return digest


def _empty(name: str, entry: MethodEntry) -> nn.Module:
    """Return a model to be filled: without memory for its weights, where that can be had."""
    import torch

    with torch.device("meta") if entry.builder is None else contextlib.nullcontext():
        return _untrained(name, entry)


def _untrained(name: str, entry: MethodEntry) -> nn.Module:
    if entry.builder is not None:
        return _as_module(_function(entry.builder)())
    if name not in _BUILDERS:
        raise ManifestError(
            f"methods.{name}: this version has no model of that name; it has {', '.join(_BUILDERS)}. "
            f"A method from outside needs the key 'builder: package.module:function'"
        )
    return build(name)


def fingerprint(name: str, entry: MethodEntry) -> dict[str, Any]:
    """Return all that a method's descriptors depend on besides the images; part of their content key."""
    inputs: dict[str, Any] = {"name": name, "preprocessing": entry.preprocessing.model_dump()}
    if entry.builder is not None:
        inputs["builder"], inputs["source"] = entry.builder, _source_digest(entry.builder)
    else:
        inputs["revision"] = _BUILDERS[name][1] if name in _BUILDERS else 0
    if entry.weights is not None:
        inputs["weights"] = weights.digests(entry.weights)
    if entry.batch_dependent:
        inputs["batch_size"] = entry.batch_size
    return inputs


def _source_digest(builder: str) -> str | None:
    """Digest of the file that holds a builder, so that a changed method is described anew."""
    try:
        spec = importlib.util.find_spec(builder.partition(":")[0])
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return None
    return store.digest_of_file(Path(spec.origin))


def _function(path: str) -> Callable[..., Any]:
    module, _, function = path.partition(":")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ManifestError(f"the builder {path!r} cannot be imported: {error}") from None


def _as_module(model: Any) -> nn.Module:
    from torch import nn

    if isinstance(model, nn.Module):
        return model.eval()
    if not callable(model):
        raise ManifestError(f"a builder must return an nn.Module or a function, it returned {type(model).__name__}")

    class Function(nn.Module):
        """A plain function from images to descriptors as a model."""

        def forward(self, images: Any) -> Any:
            return model(images)

    return Function().eval()
