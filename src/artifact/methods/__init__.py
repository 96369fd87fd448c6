"""Descriptor models by name.

A model is a ``torch.nn.Module`` in eval mode: images ``(b, c, h, w)`` float32, already prepared as the method's
manifest entry says, to unit-length descriptors ``(b, d)`` float32.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from artifact.manifest import ManifestError, MethodEntry

if TYPE_CHECKING:
    from torch import nn

# Where each model is built. Raise a revision when the descriptors of that model change: it is part of the
# descriptors' content key. Modules are imported only when a model is built.
_BUILDERS: dict[str, tuple[str, int]] = {
    "thumbnail": ("artifact.methods.thumbnail:Thumbnail", 1),
    "hog": ("artifact.methods.hog:HOG", 1),
    "efficientnet_lite0": ("artifact.methods.efficientnet_lite:efficientnet_lite0", 1),
    "anyloc": ("artifact.methods.anyloc:anyloc", 1),
    "boq": ("artifact.methods.boq:boq", 1),
    "cosplace": ("artifact.methods.cosplace:cosplace", 1),
    "cricavpr": ("artifact.methods.cricavpr:cricavpr", 1),
    "eigenplaces": ("artifact.methods.cosplace:eigenplaces", 1),
    "megaloc": ("artifact.methods.megaloc:megaloc", 1),
    "mixvpr": ("artifact.methods.mixvpr:mixvpr", 1),
    "salad": ("artifact.methods.salad:salad", 1),
    "salad_cm": ("artifact.methods.salad:salad_cm", 1),
    "selavpr": ("artifact.methods.selavpr:selavpr", 1),
    "selavprpp": ("artifact.methods.selavprpp:selavprpp", 1),
}


def names() -> list[str]:
    """Return the names that :func:`build` knows.

    Examples
    --------
    >>> "hog" in names()
    True
    """
    return list(_BUILDERS)


def build(name: str, **options: Any) -> nn.Module:
    """Build a model by name, in eval mode.

    Parameters
    ----------
    name
        One of :func:`names`.
    **options
        Passed on to the builder.

    Raises
    ------
    KeyError
        If the name is unknown; the message lists those that exist.

    Examples
    --------
    >>> build("hog", orientations=6).orientations
    6
    """
    if name not in _BUILDERS:
        raise KeyError(f"no method {name!r}; the methods are {', '.join(_BUILDERS)}")
    return _function(_BUILDERS[name][0])(**options).eval()


def model_of(name: str, entry: MethodEntry) -> nn.Module:
    """Build the model of a manifest entry: its ``builder`` if it has one, else the library's model of that name.

    Raises
    ------
    ManifestError
        If the entry names no builder and the library has no such model, or the builder cannot be imported.
    """
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
        inputs["builder"] = entry.builder
    else:
        inputs["revision"] = _BUILDERS[name][1] if name in _BUILDERS else 0
    if entry.batch_dependent:
        inputs["batch_size"] = entry.batch_size
    return inputs


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
