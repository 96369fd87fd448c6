"""What every notebook does first: settle which datasets and methods it shows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from artifact import datasets as data
from artifact import manifest as manifests
from artifact.datasets.appearance import has_appearance
from artifact.manifest import TYPED_IN, Manifest
from artifact.manifest.entries import ManifestError
from artifact.pages.style import use_style
from artifact.studies import preview
from artifact.studies.common import NothingToShowError, single_stage

__all__ = ["NothingToShowError", "Page", "open_page"]


MADE = "Rehearsal: made descriptors. No number on this page is a result; it shows that the page can be made."


@dataclass(frozen=True)
class Page:
    """The settled scope of one notebook.

    Attributes
    ----------
    manifest
        The manifest.
    profile
        Name of the profile.
    datasets, methods
        Names, in the order shown.
    asked
        The notebook's further parameters, as given.
    """

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
        settled = ("dataset", "datasets", "method", "methods")
        return {"profile": self.profile} | {
            name: getattr(self, name) if name in settled else value for name, value in self.asked.items()
        }

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
        counts = [f"{text}." for name in counted for text in data.load(self.manifest, name).differences]
        own = [name for name in self.datasets if name not in self.manifest.datasets]
        counts += [f"Warning: {text}." for name in own for text in preview.remarks(self.manifest, name)]
        return " ".join([f"Measured by profile “{self.profile}” on {' and '.join(images)} with {with_what}.", *counts])

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
        single_stage: bool = False,
        prefer: Literal["real", "metres"] | None = None,
    ) -> Page:
        """Return the page with one dataset: the one that its parameter names, or the first of the profile that suits.

        If the page has one method, it is the one that its parameter names, or the last of the profile that suits.

        Parameters
        ----------
        unit
            Unit that the threshold must have.
        distractor_traversals, same_condition_traversal
            Whether the manifest must name traversals of further conditions, or of the query's kind of condition.
        images
            Whether the images of the pair must be at hand.
        single_stage
            Whether the method must not re-rank: its descriptors then are all there is to it.
        prefer
            What comes first: real images, or a threshold in metres.

        Raises
        ------
        ManifestError
            If the named method does not suit; the message says what is needed.
        NothingToShowError
            If the named dataset does not suit, or none of the profile does.
        """
        page = self._with_one_method(single_stage) if "method" in self.asked else self
        entries = {name: self.manifest.dataset(name) for name in self.datasets}
        last = {
            "real": lambda name: entries[name].kind == "city",
            "metres": lambda name: entries[name].threshold.unit != "metres",
            None: lambda _: False,
        }[prefer]
        for name in sorted(entries, key=last):
            entry = entries[name]
            if (
                (unit is None or entry.threshold.unit == unit)
                and (entry.distractor_traversals or not distractor_traversals)
                and (entry.same_condition_traversal or not same_condition_traversal)
                and (not images or self._has_images(name))
            ):
                return page.only(name)
        needs = [f"a threshold in {unit}"] if unit else []
        needs += ["the key distractor_traversals"] if distractor_traversals else []
        needs += ["the key same_condition_traversal"] if same_condition_traversal else []
        needs += ["its images at hand"] if images else []
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
        queries = {name: data.load(self.manifest, name).query for name in self.datasets}
        names = tuple(name for name, query in queries.items() if has_appearance(query))
        if not names:
            raise NothingToShowError("this page needs images or their statistics; no dataset of this run has them")
        return self.only(*names)

    def _with_one_method(self, alone: bool) -> Page:
        suiting = single_stage(self.manifest, self.methods) if alone else self.methods
        if suiting:
            return replace(self, methods=(suiting[-1],))
        need = "this page needs a method that does not re-rank"
        if self.asked["method"] is not None:
            raise ManifestError(f"method {self.methods[0]!r}: {need}")
        raise NothingToShowError(f"{need}; no method of profile {self.profile!r} is one")

    def _has_images(self, name: str) -> bool:
        loaded = data.load(self.manifest, name)
        return loaded.query.has_images and loaded.database.has_images

    def load_all(self, dataset: str) -> data.Dataset:
        """Load a dataset with all of its traversals."""
        return data.load(self.manifest, dataset, self.manifest.dataset(dataset).traversals)


def open_page(profile: str, **parameters: Any) -> Page:
    """Settle a notebook's scope and set the figure style.

    Parameters
    ----------
    profile
        Profile of the manifest.
    **parameters
        All other parameters of the notebook, so that its provenance shows them. ``datasets`` and ``methods`` are lists
        of names, ``dataset`` and ``method`` one name; ``None`` takes all of the profile. A page
        with ``dataset`` or ``method`` then calls :meth:`Page.choose`.
    """
    use_style()
    manifest = manifests.load().for_profile(profile)
    # A notebook that a command runs starts in another folder than the command; one that is opened by hand, in any.
    manifest = replace(manifest, relative_to=Path(os.environ.get(TYPED_IN, manifest.path.parent)))
    entry = manifest.profile(profile)

    def named(several: str, one: str, default: list[str]) -> tuple[str, ...]:
        if parameters.get(one) is not None:
            return (parameters[one],)
        return tuple(default if parameters.get(several) is None else parameters[several])

    datasets, methods = named("datasets", "dataset", entry.datasets), named("methods", "method", entry.methods)
    for name in datasets:
        manifest.dataset(name)
    for name in methods:
        manifest.method(name)
    return Page(manifest, profile, datasets, methods, parameters)
