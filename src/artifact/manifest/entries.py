"""The entries of a manifest, typed and strict."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Unit = Literal["metres", "frames", "pairs"]
Positions = Literal["csv", "names", "order"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.,+-]*$")]


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

    ``descriptors`` are files of descriptors that another tool made, by method: ``.npy``, one row for each row of the
    positions file; ``second_stage`` the same for local features or packed codes of two-stage methods. With them a
    traversal needs no images.
    """

    condition: str
    images: str | None = None
    positions: Positions | None = None
    positions_file: str | None = None
    image_list: str | None = None
    spacing: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    render: dict[str, Any] | None = None
    descriptors: dict[str, str] = {}
    second_stage: dict[str, str] = {}


class Source(_Strict):
    """Where the files of a dataset come from."""

    url: str
    note: str = ""


class PaperCounts(_Strict):
    """Image counts that the paper states; a difference is shown wherever the dataset is used.

    ``choices`` names what the paper leaves open and the counts depend on, to be shown with a difference.
    """

    queries: int = Field(gt=0)
    database: int = Field(gt=0)
    evaluated: int | None = Field(default=None, gt=0)
    choices: str = ""


class _FromElsewhere(_Strict):
    """A file that others published.

    ``urls`` are tried in order: the owners' first, then mirrors. ``size`` in bytes and ``sha256`` are given where they
    are known, else the first file is recorded in a lock file; ``megabytes`` is an estimate to show before the download.
    """

    urls: list[Annotated[str, Field(pattern=r"^https?://[^\s]+$")]] = []
    size: int | None = Field(default=None, gt=0)
    megabytes: float | None = Field(default=None, gt=0)
    sha256: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")

    @property
    def n_bytes(self) -> float:
        """Bytes of the file as far as they are known or estimated, else 0."""
        return self.size or 1e6 * (self.megabytes or 0)


class PublishedFile(_FromElsewhere):
    """A file as the owners of a dataset publish it, or several that differ by traversal and part.

    ``file`` may hold ``{traversal}`` and ``{part:02}``, which runs from 1 to ``parts``; size and digest are those of each.
    Without ``urls``, a person puts the file into the folder of downloads. ``traversals`` need it (default: all), and those
    alone whose preparation has one of the values in ``when``.
    """

    file: str = Field(pattern=r"^[A-Za-z0-9{][A-Za-z0-9_.,+(){}:-]*$")
    parts: int | None = Field(default=None, gt=0)
    traversals: list[Name] = []
    when: dict[str, list[Any]] = {}


class PreparationEntry(_Strict):
    """How the published files of a dataset become its traversals.

    ``recipe`` is the dataset whose published form the files have; ``parameters`` are those of the recipe.
    ``used_as_unpacked`` says that an unpacked archive is a dataset already, so that a folder made by hand may be used.
    """

    recipe: Literal["amstertime", "gardens_point", "nordland", "robotcar", "st_lucia", "svox"]
    files: list[PublishedFile] = Field(min_length=1)
    parameters: dict[str, Any] = {}
    used_as_unpacked: bool = False


class DatasetEntry(_Strict):
    """A query traversal, a database traversal and the threshold between them.

    ``distractor_traversals`` offer pools of further conditions (paper Fig. 7). ``same_condition_traversal`` has the
    query's kind of condition; some of its frames join the database in the maps (Figs. 2 and 9). ``by_name`` pairs
    frames by their file names (without endings) where a traversal lacks some, instead of by their order.
    ``irrelevant_pairs`` are query–database pairs of conditions that no transform is fitted on (Table V).
    ``coordinates`` names the frame that positions are in, for datasets that share places; default: the ``root``.
    ``reported_as`` is the paper's name of the dataset, where its numbers can be compared. ``preparation`` makes the
    traversals from published files; ``citation`` and ``licence`` are those of the images.
    """

    title: str
    kind: Literal["folder", "city", "made"]
    threshold: Threshold
    query: Name
    database: Name
    traversals: dict[Name, TraversalEntry]
    shift: str = ""
    root: str | None = None
    mirrors: str | None = None
    coordinates: str | None = None
    distractor_traversals: list[Name] = []
    same_condition_traversal: Name | None = None
    by_name: bool = False
    irrelevant_pairs: list[Annotated[list[Name], Field(min_length=2, max_length=2)]] = []
    sources: list[Source] = []
    licence: str = "not stated"
    citation: str = ""
    obtain: str = ""
    preparation: PreparationEntry | None = None
    reported_as: str | None = None
    paper: PaperCounts | None = None

    @model_validator(mode="after")
    def _traversals_exist(self) -> DatasetEntry:
        if self.kind == "made":
            raise ValueError("found kind 'made', which a profile with 'made: true' makes; allowed: 'folder' or 'city'")
        named = [("query", self.query), ("database", self.database)]
        named += [("distractor_traversals", name) for name in self.distractor_traversals]
        named += [("same_condition_traversal", name) for name in (self.same_condition_traversal,) if name]
        named += [("irrelevant_pairs", name) for pair in self.irrelevant_pairs for name in pair]
        for key, name in named:
            if name not in self.traversals:
                raise ValueError(f"{key} names the traversal {name!r}; the traversals are {quoted(self.traversals)}")
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
            remedy = "for antialias: false use library 'tensor'"
            raise ValueError(f"library 'pillow' always filters before shrinking; {remedy}")
        channels = 3 if self.colour == "rgb" else 1
        if not len(self.mean) == len(self.std) == channels:
            raise ValueError(f"colour {self.colour!r} needs {channels} values of mean and std")
        return self


class WeightsFile(_FromElsewhere):
    """One released file of trained weights.

    A Google Drive link is given as people open it, ``https://drive.google.com/file/d/ID/view``. ``git_blob`` is the SHA-1
    by which git names the file. ``container`` is the key of the checkpoint that holds the weights, or ``flat``. ``tensor``
    says that the file is a single tensor, and its name in the model.
    """

    file: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.,+()-]*$")
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
        for what in ("file", "tensor"):
            values = [getattr(file, what) for file in self.files]
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

    Methods of the same ``trunk`` differ in what they make of its features alone: one pass through it describes images by all
    of them.

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
    trunk: Name | None = None
    builder: str | None = Field(default=None, pattern=r"^[\w.]+:\w+$")
    weights: WeightsEntry | None = None
    licence: str = "not stated"

    @model_validator(mode="after")
    def _second_stage_is_one(self) -> MethodEntry:
        named = [key for key in ("local_features", "code_bits") if getattr(self, key) is not None]
        if len(named) > 1 or (named and self.rerank is None):
            found = f"{' and '.join(named)} {'without rerank' if self.rerank is None else 'together'}"
            needed = "a two-stage method has rerank and one of local_features and code_bits"
            raise ValueError(f"found {found}; {needed}")
        if self.trunk is not None and (self.rerank or self.builder or self.weights or self.batch_dependent):
            raise ValueError("a method with trunk has none of the keys rerank, builder, weights and batch_dependent")
        return self


class ProfileEntry(_Strict):
    """What one run covers: datasets, methods and notebook parameters.

    ``made`` puts made descriptors in the place of images and weights: a rehearsal of a run, never a result.
    """

    description: str
    datasets: list[str] = Field(min_length=1)
    methods: list[str] = Field(min_length=1)
    parameters: dict[str, dict[str, Any]] = {}
    made: bool = False


class Document(_Strict):
    """A whole manifest file."""

    version: Literal[1]
    data_root: str = "data"
    datasets: dict[Name, DatasetEntry]
    methods: dict[Name, MethodEntry]
    profiles: dict[Name, ProfileEntry]

    @model_validator(mode="after")
    def _profiles_name_entries(self) -> Document:
        for name, profile in self.profiles.items():
            for kind, known in (("datasets", self.datasets), ("methods", self.methods)):
                for entry in getattr(profile, kind):
                    if entry not in known:
                        raise ValueError(f"profiles.{name}.{kind} names {entry!r}; the {kind} are {quoted(known)}")
        return self

    @model_validator(mode="after")
    def _methods_of_a_trunk_see_the_same(self) -> Document:
        first: dict[str, str] = {}
        for name, method in self.methods.items():
            other = first.setdefault(method.trunk, name) if method.trunk else name
            for key in ("preprocessing", "batch_size"):
                if getattr(method, key) != getattr(self.methods[other], key):
                    raise ValueError(
                        f"methods.{name} and methods.{other} have the same trunk: their {key} must be equal"
                    )
        return self


def quoted(names: Any) -> str:
    """List names for a message."""
    return ", ".join(repr(name) for name in names)
