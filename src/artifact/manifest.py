"""The manifest: one typed, strict file that names every dataset, traversal, method and profile.

Everything that changes a number is data in ``data_manifest.yaml``, written once. A wrong key, type, path or
unit raises :class:`ManifestError`, which names the file, the line, the key path, the value found and the
values allowed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Unit = Literal["metres", "frames", "pairs"]
Positions = Literal["csv", "names", "order"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.,+-]*$")]

DATA_ROOT_VARIABLE = "ARTIFACT_DATA_ROOT"


class ManifestError(ValueError):
    """A manifest that cannot be used; the message says where, what was found and what is allowed."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Threshold(_Strict):
    """Distance at or below which a database image is a positive (paper Table I).

    ``value`` is in metres for ``unit: metres``, in frames for ``unit: frames``; ``unit: pairs`` is an exact
    match of the pair index and takes the value 0.
    """

    value: float = Field(ge=0, allow_inf_nan=False)
    unit: Unit

    @model_validator(mode="after")
    def _pairs_are_exact(self) -> Threshold:
        if self.unit == "pairs" and self.value != 0:
            raise ValueError(f"unit 'pairs' is an exact match: value must be 0, found {self.value:g}")
        return self

    def __str__(self) -> str:
        """The threshold as the paper's Table I prints it."""
        if self.unit == "pairs":
            return "exact match"
        if self.unit == "metres":
            return f"{self.value:g} m"
        return f"±{self.value:g} frame{'' if self.value == 1 else 's'}"


class TraversalEntry(_Strict):
    """One pass through the places of a dataset, under one condition.

    ``images`` is a folder below the dataset's root (default: the traversal's name). ``positions`` says where
    the positions come from: ``csv`` (``positions.csv`` beside the images, or ``positions_file``), ``names``
    (``@utm_east@utm_north@...`` file names) or ``order`` (the frame order). ``image_list`` is a text file of
    file names that selects and orders the images. ``spacing`` thins the traversal: a frame is kept when it
    is at least that many metres from the last frame kept. ``render`` describes a rendered traversal.
    """

    condition: str
    images: str | None = None
    positions: Positions | None = None
    positions_file: str | None = None
    image_list: str | None = None
    spacing: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    render: dict[str, Any] | None = None


class Source(_Strict):
    """Where the files of a dataset come from."""

    url: str
    note: str = ""


class PaperCounts(_Strict):
    """Image counts that the paper states; asserted when the real dataset is loaded."""

    queries: int = Field(gt=0)
    database: int = Field(gt=0)
    evaluated: int | None = Field(default=None, gt=0)


class DatasetEntry(_Strict):
    """A query traversal, a database traversal and the threshold between them.

    ``distractor_traversals`` offer pools of further conditions (paper Fig. 7). ``same_condition_traversal`` has the
    query's kind of condition; some of its frames join the database in the maps (Figs. 2 and 9).
    ``irrelevant_pairs`` are query–database pairs of conditions that no transform is fitted on (Table V).
    ``reported_as`` is the paper's name of the dataset, where its numbers can be compared.
    """

    title: str
    kind: Literal["folder", "gardens_point", "city"]
    threshold: Threshold
    query: Name
    database: Name
    traversals: dict[Name, TraversalEntry]
    shift: str = ""
    root: str | None = None
    mirrors: str | None = None
    distractor_traversals: list[Name] = []
    same_condition_traversal: Name | None = None
    irrelevant_pairs: list[Annotated[list[Name], Field(min_length=2, max_length=2)]] = []
    sources: list[Source] = []
    licence: str = "not stated"
    obtain: str = ""
    reported_as: str | None = None
    paper: PaperCounts | None = None

    @model_validator(mode="after")
    def _traversals_exist(self) -> DatasetEntry:
        named = {"query": [self.query], "database": [self.database]}
        named["distractor_traversals"] = self.distractor_traversals
        named["same_condition_traversal"] = [self.same_condition_traversal] if self.same_condition_traversal else []
        named["irrelevant_pairs"] = [name for pair in self.irrelevant_pairs for name in pair]
        for key, names in named.items():
            for name in names:
                if name not in self.traversals:
                    raise ValueError(
                        f"{key} names the traversal {name!r}; the traversals are {_quoted(self.traversals)}"
                    )
        for name, traversal in self.traversals.items():
            if (self.kind == "city") != (traversal.render is not None):
                need = "needs" if self.kind == "city" else "cannot have"
                raise ValueError(f"traversal {name!r} {need} the key 'render' in a dataset of kind {self.kind!r}")
        return self


class Preprocessing(_Strict):
    """How an image becomes a model's input; recorded with every descriptor.

    ``resize`` is ``fixed`` (to ``size``, height and width in pixels) or ``native`` (as stored, but at most
    ``longest_side`` pixels on the longer side). ``library`` says who resizes: ``pillow`` works on 8-bit
    values and always filters before shrinking, ``tensor`` works on floats, with ``antialias`` or without.
    ``crop_to_multiple_of`` then cuts a centred crop whose sides are multiples of it. ``mean`` and ``std`` are
    in units of the full scale (0 to 1), one per channel.
    """

    resize: Literal["fixed", "native"]
    size: list[Annotated[int, Field(gt=0)]] | None = Field(default=None, min_length=2, max_length=2)
    longest_side: int | None = Field(default=None, gt=0)
    interpolation: Literal["bilinear", "bicubic"] = "bilinear"
    antialias: bool = True
    library: Literal["pillow", "tensor"] = "pillow"
    crop_to_multiple_of: int = Field(default=1, gt=0)
    colour: Literal["rgb", "grey"] = "rgb"
    mean: list[float] = [0.485, 0.456, 0.406]
    std: list[Annotated[float, Field(gt=0)]] = [0.229, 0.224, 0.225]

    @model_validator(mode="after")
    def _is_consistent(self) -> Preprocessing:
        if (self.resize == "fixed") != (self.size is not None):
            raise ValueError("resize 'fixed' needs the key 'size' (height and width), resize 'native' cannot have it")
        if self.library == "pillow" and not self.antialias:
            raise ValueError(
                "library 'pillow' always filters before shrinking; for antialias: false use library 'tensor'"
            )
        channels = 3 if self.colour == "rgb" else 1
        if not len(self.mean) == len(self.std) == channels:
            raise ValueError(f"colour {self.colour!r} needs {channels} values of mean and std")
        return self


class WeightsFile(_Strict):
    """One released file of trained weights.

    ``urls`` are tried in order: the authors' first, then mirrors. A Google Drive link is given as people open it,
    ``https://drive.google.com/file/d/ID/view``. ``size`` in bytes, ``sha256`` and ``git_blob`` (the SHA-1 by which git
    names a file) are those of the released file where they are known; else the first download is recorded in a lock
    file. ``megabytes`` is an estimate to show before the download. ``container`` is the key of the checkpoint that
    holds the weights, or ``flat``. ``tensor`` says that the file is a single tensor, and its name in the model.
    """

    file: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.,+()-]*$")
    urls: list[Annotated[str, Field(pattern=r"^https?://[^\s]+$")]] = []
    size: int | None = Field(default=None, gt=0)
    megabytes: float | None = Field(default=None, gt=0)
    sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")
    git_blob: str | None = Field(default=None, pattern=r"^[0-9a-f]{40}$")
    container: Literal["flat", "state_dict", "model_state_dict"] | None = None
    tensor: str | None = None


class WeightsEntry(_Strict):
    """The released weights of a method, all that its model needs.

    ``licence`` and ``terms`` are shown before a download. ``obtain`` says how to get what cannot be downloaded.
    ``folder`` holds the files; a relative one is below the data root (and made absolute when a manifest is read).
    """

    files: list[WeightsFile] = Field(min_length=1)
    licence: str
    terms: str = ""
    obtain: str = ""
    folder: str = "weights"

    @model_validator(mode="after")
    def _files_differ(self) -> WeightsEntry:
        for what, values in (("file", [f.file for f in self.files]), ("tensor", [f.tensor for f in self.files])):
            for value in values:
                if values.count(value) > 1:
                    named = f"{what} {value!r}" if value else "a file without the key 'tensor'"
                    raise ValueError(f"{named} is named twice; all but one file hold a single tensor each")
        return self


class LocalFeatures(_Strict):
    """Local features of a method that ranks candidates again by them.

    ``shape`` is rows, columns and dimension of the features of one image. ``dtype`` is what they are stored as;
    ``float16`` takes half the disk and rounds them.
    """

    shape: list[Annotated[int, Field(gt=0)]] = Field(min_length=2)
    dtype: Literal["float32", "float16"] = "float32"


class MethodEntry(_Strict):
    """One descriptor method, with the columns of the paper's Table II.

    ``builder`` names a function ``package.module:function`` that returns the model, for a method from outside
    this library. ``weights`` are loaded into the model; a method of kind ``paper`` does not run without them, unless
    its builder brings its own. ``batch_dependent`` marks models whose descriptors depend on which images share a batch.

    ``rerank`` is the number of candidates that a two-stage method ranks again. With ``local_features``, descriptors
    find the candidates and mutual nearest local features rank them (SelaVPR); with ``code_bits``, hash codes of that
    length find them by Hamming distance and descriptors rank them (SelaVPR++).
    """

    title: str
    kind: Literal["baseline", "paper"]
    backbone: str
    aggregation: str
    dimension: int = Field(gt=0)
    train_data: str = "–"
    rerank: int | None = Field(default=None, gt=0)
    local_features: LocalFeatures | None = None
    code_bits: int | None = Field(default=None, gt=0)
    preprocessing: Preprocessing
    batch_size: int = Field(default=16, gt=0)
    batch_dependent: bool = False
    builder: str | None = Field(default=None, pattern=r"^[\w.]+:\w+$")
    weights: WeightsEntry | None = None
    licence: str = "not stated"
    reference: str | None = None

    @model_validator(mode="after")
    def _second_stage_is_one(self) -> MethodEntry:
        named = [key for key in ("local_features", "code_bits") if getattr(self, key) is not None]
        if len(named) > 1 or (named and self.rerank is None):
            raise ValueError(
                f"found {' and '.join(named)} {'without rerank' if self.rerank is None else 'together'}; a two-stage "
                f"method has rerank and one of local_features and code_bits"
            )
        return self


class ProfileEntry(_Strict):
    """What one run covers: datasets, methods and notebook parameters."""

    description: str
    datasets: list[str] = Field(min_length=1)
    methods: list[str] = Field(min_length=1)
    parameters: dict[str, dict[str, Any]] = {}


class _Document(_Strict):
    version: Literal[1]
    data_root: str = "data"
    datasets: dict[Name, DatasetEntry]
    methods: dict[Name, MethodEntry]
    profiles: dict[Name, ProfileEntry]

    @model_validator(mode="after")
    def _profiles_name_entries(self) -> _Document:
        for name, profile in self.profiles.items():
            for kind, known in (("datasets", self.datasets), ("methods", self.methods)):
                for entry in getattr(profile, kind):
                    if entry not in known:
                        raise ValueError(f"profiles.{name}.{kind} names {entry!r}; the {kind} are {_quoted(known)}")
        return self


@dataclass(frozen=True)
class Manifest:
    """A checked manifest.

    Attributes
    ----------
    path
        The file it was read from.
    data_root
        Folder that holds the datasets: ``$ARTIFACT_DATA_ROOT`` if set, else the manifest's ``data_root``
        (relative to the manifest).
    datasets, methods, profiles
        The entries by name, in the order of the file.
    """

    path: Path
    data_root: Path
    datasets: dict[str, DatasetEntry]
    methods: dict[str, MethodEntry]
    profiles: dict[str, ProfileEntry]

    def dataset(self, name: str) -> DatasetEntry:
        """Return one dataset entry, or raise :class:`ManifestError` with the names that exist."""
        return _lookup(self.datasets, name, "dataset", self.path)

    def method(self, name: str) -> MethodEntry:
        """Return one method entry, or raise :class:`ManifestError` with the names that exist."""
        return _lookup(self.methods, name, "method", self.path)

    def profile(self, name: str) -> ProfileEntry:
        """Return one profile entry, or raise :class:`ManifestError` with the names that exist."""
        return _lookup(self.profiles, name, "profile", self.path)


def load(path: str | os.PathLike[str] | None = None) -> Manifest:
    """Read and check a manifest.

    Parameters
    ----------
    path
        The file; by default ``data_manifest.yaml`` in the working folder or the nearest folder above it.

    Raises
    ------
    ManifestError
        If the file is missing, is not YAML, repeats a key, or holds a key, type, value or name that is not
        allowed. All faults are listed at once.
    """
    path = find() if path is None else Path(path)
    if not path.is_file():
        raise ManifestError(f"{path}: no such file; the manifest is data_manifest.yaml at the top of the repository")
    root = _compose(path)
    try:
        document = _Document.model_validate(_plain(root, path))
    except ValidationError as error:
        raise ManifestError("\n".join(_explain(error, root, path))) from None
    chosen = os.environ.get(DATA_ROOT_VARIABLE)
    data_root = Path(chosen).expanduser() if chosen else path.resolve().parent / Path(document.data_root).expanduser()
    return Manifest(
        path=path.resolve(),
        data_root=data_root.resolve(),
        datasets=document.datasets,
        methods={name: _with_folder(entry, data_root.resolve()) for name, entry in document.methods.items()},
        profiles=document.profiles,
    )


def _with_folder(entry: MethodEntry, data_root: Path) -> MethodEntry:
    if entry.weights is None:
        return entry
    folder = data_root / Path(entry.weights.folder).expanduser()
    return entry.model_copy(update={"weights": entry.weights.model_copy(update={"folder": str(folder)})})


def parse_dataset(path: Path, root: str) -> DatasetEntry:
    """Read one dataset entry from a file of its own (``dataset.yaml``), with the same strictness.

    Parameters
    ----------
    path
        The file.
    root
        Folder of the dataset, used when the entry does not name one.
    """
    node = _compose(path)
    try:
        entry = DatasetEntry.model_validate(_plain(node, path))
    except ValidationError as error:
        raise ManifestError("\n".join(_explain(error, node, path, DatasetEntry))) from None
    return entry if entry.root else entry.model_copy(update={"root": root})


def find(start: str | os.PathLike[str] | None = None) -> Path:
    """Return the nearest ``data_manifest.yaml`` in ``start`` (default: the working folder) or above it.

    If there is none, the manifest of the repository that the package is installed from is taken.

    Raises
    ------
    ManifestError
        If there is none.
    """
    folder = Path(start or Path.cwd()).resolve()
    repository = Path(__file__).resolve().parents[2]
    for candidate in (folder, *folder.parents, repository):
        if (candidate / "data_manifest.yaml").is_file():
            return candidate / "data_manifest.yaml"
    raise ManifestError(f"no data_manifest.yaml in {folder} or above it; run from inside the repository")


def _lookup(entries: dict[str, Any], name: str, kind: str, path: Path) -> Any:
    if name not in entries:
        raise ManifestError(f"{path}: no {kind} {name!r}; the {kind}s are {_quoted(entries)}")
    return entries[name]


def _quoted(names: Any) -> str:
    return ", ".join(repr(name) for name in names)


# -- YAML with line numbers -------------------------------------------------------------------------------------------


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
        raise ManifestError(
            f"{path}: found an empty or plain document; allowed: a mapping with the keys {_quoted(_Document.model_fields)}"
        )
    return node


def _plain(node: yaml.Node, path: Path) -> Any:
    """Build plain Python values, refusing a key that is written twice (YAML would keep the last silently)."""
    if isinstance(node, yaml.MappingNode):
        seen: dict[Any, int] = {}
        result = {}
        for key_node, value_node in node.value:
            key = _plain(key_node, path)
            if key in seen:
                raise ManifestError(
                    f"{path}:{key_node.start_mark.line + 1}: the key {key!r} is already on line {seen[key]}"
                )
            seen[key] = key_node.start_mark.line + 1
            result[key] = _plain(value_node, path)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, path) for item in node.value]
    loader = yaml.SafeLoader("")
    try:
        value = loader.construct_object(node)
    finally:
        loader.dispose()
    # A number is accepted where a float is asked for, as every YAML author expects of `value: 25`.
    return value


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


def _explain(error: ValidationError, root: yaml.Node, path: Path, model: type[BaseModel] = _Document) -> Iterator[str]:
    for fault in error.errors():
        location = tuple(part for part in fault["loc"] if part != "[key]")
        where = f"{path}:{_line(root, location)}: {'.'.join(map(str, location)) or 'manifest'}"
        match fault["type"]:
            case "extra_forbidden":
                yield f"{where}: unknown key; allowed: {_quoted(_fields_at(model, location[:-1]))}"
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
        annotation = (
            next(
                (a for a in get_args(annotation) if isinstance(a, type) and issubclass(a, BaseModel)),
                annotation,
            )
            if get_origin(annotation) in (Union, UnionType)
            else annotation
        )
    return list(annotation.model_fields)
