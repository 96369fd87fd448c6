"""What every notebook does first: settle which datasets and methods it shows."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from IPython.display import display

from artifact import datasets as data
from artifact import manifest as manifests
from artifact.datasets.appearance import has_appearance
from artifact.extraction import extract
from artifact.manifest import TYPED_IN, Manifest
from artifact.manifest.entries import ManifestError
from artifact.pages.parameters import ParameterError, faults, injected, settled, unknown
from artifact.pages.style import page_style, use_style
from artifact.studies import preview
from artifact.studies.common import NothingToShowError, single_stage

MADE = "Rehearsal: made descriptors. No number on this page is a result; it shows that the page can be made."


@dataclass(frozen=True)
class Page:
    """The settled scope of one notebook: datasets and methods in the order shown, and further parameters as given."""

    manifest: Manifest
    profile: str
    datasets: tuple[str, ...]
    methods: tuple[str, ...]
    asked: Mapping[str, Any]

    @property
    def dataset(self) -> str:
        """The first dataset: the only one of a page that shows one."""
        return self.datasets[0]

    @property
    def method(self) -> str:
        """The first method: the only one of a page that shows one."""
        return self.methods[0]

    @property
    def parameters(self) -> dict[str, Any]:
        """All parameters of the notebook, with names in place of ``None`` once they are settled."""
        settled = {"dataset", "datasets", "method", "methods"} & self.asked.keys()
        return {"profile": self.profile, **self.asked} | {name: getattr(self, name) for name in settled}

    @property
    def method_titles(self) -> dict[str, str]:
        """Printed title of each method shown."""
        return {name: self.manifest.method(name).title for name in self.methods}

    @property
    def dataset_titles(self) -> dict[str, str]:
        """Printed title of each dataset shown."""
        return {name: self.manifest.dataset(name).title for name in self.datasets}

    @property
    def rendered(self) -> tuple[str, ...]:
        """The datasets that are rendered."""
        return tuple(name for name in self.datasets if self.manifest.dataset(name).kind == "city")

    @property
    def label(self) -> str:
        """One line that says what the numbers on the page are from."""
        if self.manifest.profile(self.profile).made:
            return MADE
        kinds = {self.manifest.method(name).kind for name in self.methods}
        what = {"baseline": "baselines, not methods of the paper", "paper": "methods of the paper"}
        rendered = [self.dataset_titles[name] for name in self.rendered]
        real = [title for name, title in self.dataset_titles.items() if name not in self.rendered]
        images = [f"real images ({', '.join(real)})"] if real else []
        if rendered:
            images.append(f"rendered images ({rendered[0] if len(rendered) == 1 else f'{len(rendered)} City pairs'})")
        with_what = " and ".join(what[kind] for kind in sorted(kinds))
        counted = [name for name in self.datasets if self.manifest.dataset(name).paper is not None]
        notes = [text for name in counted for text in self._load(name).differences]
        own = [name for name in self.datasets if name not in self.manifest.datasets]
        notes += [f"Warning: {text}" for name in own for text in preview.remarks_on(self.manifest, self._load(name))]
        measured = f"Measured by profile “{self.profile}” on {' and '.join(images)} with {with_what}"
        return " ".join(f"{text}." for text in (measured, *notes))

    @property
    def conditions(self) -> tuple[str, str]:
        """Conditions of the query and the database of a page's one dataset."""
        entry = self.manifest.dataset(self.dataset)
        return entry.traversals[entry.query].condition, entry.traversals[entry.database].condition

    @property
    def mixed_conditions(self) -> tuple[str, str, str]:
        """Conditions of query, database and the traversal whose frames join the database."""
        entry = self.manifest.dataset(self.dataset)
        return *self.conditions, entry.traversals[entry.same_condition_traversal].condition

    def only(self, *datasets: str) -> Page:
        """Return the page with these datasets, in this order."""
        return replace(self, datasets=datasets)

    def choose(
        self,
        *,
        unit: str | None = None,
        distractor_traversals: bool = False,
        same_condition_traversal: bool = False,
        images: bool = False,
        descriptors: bool = False,
        single_stage: bool = False,
        prefer: Literal["real", "metres"] | None = None,
    ) -> Page:
        """Return the page with one dataset: the one that its parameter names, or the first of the profile that suits.

        If the page has one method, it is the one that its parameter names, or the last of the profile that suits: with
        ``single_stage`` one that does not re-rank. The dataset must have a threshold in ``unit``, traversals of further
        conditions or of the query's kind of condition, its images or the values of its descriptors at hand, as asked;
        ``prefer`` says what comes first, real images or a threshold in metres.

        Raises
        ------
        ManifestError
            If the named method does not suit; the message says what is needed.
        NothingToShowError
            If the named dataset does not suit, or none of the profile does.
        """
        page = self._with_one_method(single_stage) if "method" in self.asked else self
        entry = self.manifest.dataset
        last = {
            "real": lambda name: entry(name).kind == "city",
            "metres": lambda name: entry(name).threshold.unit != "metres",
            None: lambda _: False,
        }[prefer]
        checks = [
            (unit, f"a threshold in {unit}", lambda n: entry(n).threshold.unit == unit),
            (distractor_traversals, "the key distractor_traversals", lambda n: entry(n).distractor_traversals),
            (same_condition_traversal, "the key same_condition_traversal", lambda n: entry(n).same_condition_traversal),
            (images, "its images at hand", self._has_images),
            (descriptors, "the values of its descriptors at hand", page._has_descriptors),
        ]
        needs = {what: suits for asked, what, suits in checks if asked}
        for name in sorted(self.datasets, key=last):
            if all(suits(name) for suits in needs.values()):
                return page.only(name)
        need = f"this page needs a dataset with {' and '.join(needs)}"
        if self.asked.get("dataset") is not None:
            raise NothingToShowError(f"{need}; {self.dataset!r} is not one")
        raise NothingToShowError(f"{need}; no dataset of profile {self.profile!r} is one")

    def single_stage(self) -> Page:
        """Return the page with the methods that do not re-rank: suppression takes these alone, as in the paper."""
        methods = tuple(single_stage(self.manifest, self.methods))
        if not methods:
            raise NothingToShowError(f"this page needs a method that does not re-rank; found {', '.join(self.methods)}")
        return replace(self, methods=methods)

    def with_statistics(self) -> Page:
        """Return the page with the datasets of which image statistics are at hand."""
        names = [name for name in self.datasets if has_appearance(self._load(name).query, self.manifest.cache)]
        if not names:
            raise NothingToShowError("this page needs images or their statistics; no dataset of this run has them")
        return self.only(*names)

    def _with_one_method(self, alone: bool) -> Page:
        if suiting := single_stage(self.manifest, self.methods) if alone else self.methods:
            return replace(self, methods=(suiting[-1],))
        need = "this page needs a method that does not re-rank"
        if self.asked["method"] is not None:
            raise ManifestError(f"method {self.methods[0]!r}: {need}")
        raise NothingToShowError(f"{need}; no method of profile {self.profile!r} is one")

    def _load(self, name: str) -> data.Dataset:
        return data.load(self.manifest, name)

    def _has_images(self, name: str) -> bool:
        return all(traversal.has_images for traversal in self._load(name).traversals.values())

    def _has_descriptors(self, name: str) -> bool:
        traversals = self._load(name).traversals.values()
        return all(extract.is_at_hand(self.manifest, traversal, self.method) for traversal in traversals)

    def load_all(self, dataset: str) -> data.Dataset:
        """Load a dataset with all of its traversals."""
        return data.load(self.manifest, dataset, self.manifest.dataset(dataset).traversals)


def named(parameters: Mapping[str, Any], kind: str, default: Sequence[str]) -> tuple[str, ...]:
    """Return what parameters name as ``dataset`` or ``method``, else as ``datasets`` or ``methods``, else a default."""
    if parameters.get(kind) is not None:
        return (parameters[kind],)
    several = parameters.get(f"{kind}s")
    return tuple(default if several is None else several)


def open_page(profile: str, **parameters: Any) -> Page:
    """Settle a notebook's scope, given all of its parameters for its provenance, and set its style.

    ``datasets`` and ``methods`` are lists of names or one text with commas, ``dataset`` and ``method`` one name; ``None``
    takes all of the profile. A page with ``dataset`` or ``method`` then calls :meth:`Page.choose`.

    Raises
    ------
    ParameterError
        If a value is not allowed, or papermill set a name that is none of the parameters.
    """
    use_style()
    display(page_style())
    manifest = manifests.load()
    # A notebook that a command runs starts in another folder than the command; one that is opened by hand, in any.
    manifest = replace(manifest, relative_to=Path(os.environ.get(TYPED_IN, manifest.path.parent)))
    parameters = settled(parameters)
    known = {"profile": profile} | parameters
    if found := [*unknown(injected(), known), *faults(known, manifest)]:
        raise ParameterError("\n".join(found))
    manifest = manifest.for_profile(profile)
    entry = manifest.profile(profile)
    datasets, methods = named(parameters, "dataset", entry.datasets), named(parameters, "method", entry.methods)
    return Page(manifest, profile, datasets, methods, parameters)
