"""What every notebook does first: settle which datasets and methods it shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from artifact import datasets as data
from artifact import manifest as manifests
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.pages.style import use_style

__all__ = ["NothingToShowError", "Page", "open_page"]


MADE = "Rehearsal: made descriptors. No number on this page is a result; it shows that the page can be made."


class NothingToShowError(ManifestError):
    """No dataset of the run has what a page needs; the page then says so instead of failing the run."""


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
    """

    manifest: Manifest
    profile: str
    datasets: tuple[str, ...]
    methods: tuple[str, ...]

    @property
    def method_titles(self) -> dict[str, str]:
        """Printed title of each method shown."""
        return {name: self.manifest.method(name).title for name in self.methods}

    @property
    def dataset_titles(self) -> dict[str, str]:
        """Printed title of each dataset shown."""
        return {name: self.manifest.dataset(name).title for name in self.datasets}

    @property
    def label(self) -> str:
        """One line that says what the numbers on the page are from."""
        if self.manifest.profile(self.profile).made:
            return MADE
        kinds = {self.manifest.method(name).kind for name in self.methods}
        what = {"baseline": "baselines, not methods of the paper", "paper": "methods of the paper"}
        rendered = [t for n, t in self.dataset_titles.items() if self.manifest.dataset(n).kind == "city"]
        real = [t for n, t in self.dataset_titles.items() if self.manifest.dataset(n).kind != "city"]
        images = []
        if real:
            images.append(f"real images ({', '.join(real)})")
        if rendered:
            images.append(f"rendered images ({rendered[0] if len(rendered) == 1 else f'{len(rendered)} City pairs'})")
        with_what = " and ".join(what[kind] for kind in sorted(kinds))
        return f"Measured by profile “{self.profile}” on {' and '.join(images)} with {with_what}."

    def only(self, dataset: str, *methods: str) -> Page:
        """Return the page narrowed to one dataset, and to some methods if any are named."""
        return replace(self, datasets=(dataset,), methods=methods or self.methods)

    def choose(
        self,
        dataset: str | None,
        *,
        unit: str | None = None,
        distractor_traversals: bool = False,
        same_condition_traversal: bool = False,
        images: bool = False,
        prefer: Literal["real", "metres"] | None = None,
    ) -> str:
        """Return the named dataset, or the first of the profile that suits.

        Parameters
        ----------
        dataset
            A name, or ``None``.
        unit
            Unit that the threshold must have.
        distractor_traversals, same_condition_traversal
            Whether the manifest must name traversals of further conditions, or of the query's kind of condition.
        images
            Whether the images of the pair must be at hand.
        prefer
            What comes first: real images, or a threshold in metres.

        Raises
        ------
        ManifestError
            If the named dataset does not suit; the message says what is needed.
        NothingToShowError
            If no dataset of the profile suits.
        """
        candidates = list(self.datasets if dataset is None else [dataset])
        if prefer == "real":
            candidates.sort(key=lambda name: self.manifest.dataset(name).kind == "city")
        elif prefer == "metres":
            candidates.sort(key=lambda name: self.manifest.dataset(name).threshold.unit != "metres")
        for name in candidates:
            entry = self.manifest.dataset(name)
            if (
                (unit is None or entry.threshold.unit == unit)
                and (entry.distractor_traversals or not distractor_traversals)
                and (entry.same_condition_traversal or not same_condition_traversal)
                and (not images or self._has_images(name))
            ):
                return name
        needs = [f"a threshold in {unit}"] if unit else []
        needs += ["the key distractor_traversals"] if distractor_traversals else []
        needs += ["the key same_condition_traversal"] if same_condition_traversal else []
        needs += ["its images at hand"] if images else []
        need = f"this page needs a dataset with {' and '.join(needs)}"
        if dataset is not None:
            raise ManifestError(f"dataset {dataset!r}: {need}")
        raise NothingToShowError(f"{need}; no dataset of profile {self.profile!r} is one")

    def _has_images(self, name: str) -> bool:
        loaded = data.load(self.manifest, name)
        return loaded.query.has_images and loaded.database.has_images

    def rendered(self) -> list[str]:
        """Return the datasets that are rendered."""
        return [name for name in self.datasets if self.manifest.dataset(name).kind == "city"]

    def load_all(self, dataset: str) -> data.Dataset:
        """Load a dataset with all of its traversals."""
        return data.load(self.manifest, dataset, self.manifest.dataset(dataset).traversals)

    def conditions(self, dataset: str) -> tuple[str, str]:
        """Return the conditions of a dataset's query and database."""
        entry = self.manifest.dataset(dataset)
        return entry.traversals[entry.query].condition, entry.traversals[entry.database].condition

    def mixed_conditions(self, dataset: str) -> tuple[str, str, str]:
        """Return the conditions of query, database and the traversal whose frames join the database."""
        entry = self.manifest.dataset(dataset)
        return *self.conditions(dataset), entry.traversals[entry.same_condition_traversal].condition


def open_page(
    profile: str, datasets: Sequence[str] | None = None, methods: Sequence[str] | None = None
) -> Page:  # fmt: skip
    """Settle a notebook's scope and set the figure style.

    Parameters
    ----------
    profile
        Profile of the manifest.
    datasets, methods
        Names; ``None`` takes all of the profile.
    """
    use_style()
    manifest = manifests.load().for_profile(profile)
    entry = manifest.profile(profile)
    chosen = tuple(entry.datasets if datasets is None else datasets)
    described = tuple(entry.methods if methods is None else methods)
    for name in chosen:
        manifest.dataset(name)
    for name in described:
        manifest.method(name)
    return Page(manifest, profile, chosen, described)
