"""The manifest is read strictly, and says where and what is wrong."""

import pytest
from conftest import REPOSITORY, tiny_manifest, write_manifest

from artifact import manifest
from artifact.manifest.entries import ManifestError


def changed(path, value):
    """The tiny manifest with one value set, or removed if it is None, at a path of keys."""
    content = tiny_manifest()
    node = content
    for key in path[:-1]:
        node = node[key]
    if value is None:
        del node[path[-1]]
    else:
        node[path[-1]] = value
    return content


STREET = ("datasets", "street")


@pytest.mark.parametrize(
    ("path", "value", "messages"),
    [
        (
            (*STREET, "threshold", "unit"),
            "meters",
            ["datasets.street.threshold.unit", "found 'meters'", "'metres', 'frames' or 'pairs'"],
        ),
        ((*STREET, "threshold", "value"), "25 m", ["datasets.street.threshold.value", "found '25 m'", "number"]),
        ((*STREET, "threshold", "value"), -1, ["threshold.value", "found -1", "greater than or equal to 0"]),
        ((*STREET, "treshold"), 3, ["datasets.street.treshold", "unknown key", "'threshold'"]),
        ((*STREET, "title"), None, ["datasets.street.title", "missing"]),
        ((*STREET, "query"), "dawn", ["query names the traversal 'dawn'", "'day', 'night'"]),
        ((*STREET, "traversals", "day", "spacing"), 0, ["traversals.day.spacing", "found 0", "greater than 0"]),
        ((*STREET, "traversals", "day", "postions"), "csv", ["unknown key", "'positions'", "'image_list'"]),
        ((*STREET, "traversals", "day", "render"), {"town": 1}, ["'day' cannot have the key 'render'"]),
        ((*STREET, "threshold"), {"value": 1, "unit": "pairs"}, ["value must be 0, found 1"]),
        (("methods", "hog", "dimension"), "big", ["methods.hog.dimension", "found 'big'", "integer"]),
        (("methods", "hog", "preprocessing", "size"), None, ["resize 'fixed' needs the key 'size'"]),
        (("methods", "hog", "preprocessing", "mean"), [0.0, 0.1], ["colour 'grey' needs 1 values"]),
        (("methods", "hog", "preprocessing", "antialias"), False, ["'pillow' always filters"]),
        (("methods", "hog", "preprocessing", "filter"), "area", ["unknown key", "'interpolation'"]),
        (("profiles", "demo", "methods"), ["hog", "vlad"], ["names 'vlad'", "'thumbnail', 'hog'"]),
        (("version",), 2, ["version", "found 2"]),
        (("dataset",), {}, ["dataset: unknown key", "'datasets'"]),
    ],
)
def test_faults_name_line_key_value_and_what_is_allowed(tmp_path, path, value, messages):
    file = write_manifest(tmp_path, changed(path, value))
    with pytest.raises(ManifestError) as caught:
        manifest.load(file)
    text = str(caught.value)
    assert text.startswith(f"{file}:")
    line = int(text.removeprefix(f"{file}:").split(":")[0])
    lines = file.read_text().splitlines()
    expected = path[-1] if value is not None and not isinstance(value, (list, dict)) else None
    if expected and "names" not in text and "needs" not in text and "cannot" not in text and "filters" not in text:
        assert expected in lines[line - 1]
    for message in messages:
        assert message in text


def test_all_faults_are_listed_at_once(tmp_path):
    content = changed((*STREET, "threshold", "unit"), "feet")
    content["methods"]["hog"]["dimension"] = 0
    with pytest.raises(ManifestError) as caught:
        manifest.load(write_manifest(tmp_path, content))
    assert len(str(caught.value).splitlines()) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("version: 1\nversion: 1\n", ":2: the key 'version' is already on line 1"),
        ("version: [1\n", "not valid YAML"),
        ("", "found an empty or plain document"),
        ("just words", "found an empty or plain document"),
        ("version: 1\n{a: 1}: 2\n", ":2: found a list or mapping as a key"),
        (
            "version: 2014-13-45\n",
            ":1: found '2014-13-45' with the tag tag:yaml.org,2002:timestamp; allowed: plain text",
        ),
        ("version: &x [*x]\n", "is nested too deep, or an alias in it refers to what it stands in"),
        (f"version: {'[' * 5000}", "is nested too deep"),
    ],
)
def test_documents_that_are_no_manifest(tmp_path, text, message):
    file = tmp_path / "data_manifest.yaml"
    file.write_text(text)
    with pytest.raises(ManifestError, match=message.replace("[", r"\[")):
        manifest.load(file)


def test_a_missing_file_and_unknown_names(tmp_path):
    with pytest.raises(ManifestError, match="no such file"):
        manifest.load(tmp_path / "none.yaml")
    loaded = manifest.load(write_manifest(tmp_path, tiny_manifest()))
    for kind in ("dataset", "method", "profile"):
        with pytest.raises(ManifestError, match=f"no {kind} 'x'; the {kind}s are '"):
            getattr(loaded, kind)("x")


def test_the_data_root_comes_from_the_manifest_or_the_environment(tmp_path, monkeypatch):
    file = write_manifest(tmp_path, tiny_manifest())
    assert manifest.load(file).data_root == tmp_path / "data"
    monkeypatch.setenv("ARTIFACT_DATA_ROOT", str(tmp_path / "elsewhere"))
    assert manifest.load(file).data_root == tmp_path / "elsewhere"


def test_the_nearest_manifest_above_is_found(tmp_path, monkeypatch):
    file = write_manifest(tmp_path, tiny_manifest())
    (tmp_path / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "a" / "b")
    assert manifest.find() == file


def test_the_shipped_manifest_is_the_papers():
    """Tables I and II of the paper are the manifest's entries."""
    from artifact.studies import reported

    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    assert "demo" in loaded.profiles
    assert "paper" in loaded.profiles
    for row in reported.table("tab02").to_dict("records"):
        entry = loaded.method(row["method"])
        assert (entry.title, entry.backbone, entry.aggregation, entry.dimension, entry.train_data, entry.kind) == (
            row["title"],
            row["backbone"],
            row["aggregation"],
            row["dimension"],
            row["train_data"],
            "paper",
        )
        assert (f"top {entry.rerank}" if entry.rerank else "–") == row["rerank"]
    entries = {
        entry.reported_as: entry for name in loaded.profile("paper").datasets for entry in [loaded.dataset(name)]
    }
    for row in reported.table("tab01").to_dict("records"):
        entry = entries[row["dataset"]]
        assert (entry.title, str(entry.threshold), entry.shift) == (row["title"], row["threshold"], row["shift"])
        assert (entry.query, entry.database) == (row["query"], row["database"])
        assert (entry.paper.queries, entry.paper.database) == (row["queries"], row["database_images"])
        assert entry.paper.evaluated == reported.EVALUATED_QUERIES[row["dataset"]]
    cricavpr = loaded.method("cricavpr")
    assert cricavpr.batch_dependent
    assert cricavpr.batch_size == 16


def test_the_cache_folder_can_be_moved(project, monkeypatch):
    assert manifest.load(project / "data_manifest.yaml").cache == project.resolve() / ".cache"
    monkeypatch.setenv("ARTIFACT_CACHE", str(project / "fast"))
    assert manifest.load(project / "data_manifest.yaml").cache == (project / "fast").resolve()


@pytest.mark.parametrize("value", ["!!python/object/apply:os.system [ls]", "!secret x", "{<<: {a: 1}}"])
def test_tags_and_merges_are_refused_by_line(project, value):
    path = project / "data_manifest.yaml"
    path.write_text(path.read_text() + f"extra: {value}\n")
    with pytest.raises(ManifestError, match=r"data_manifest.yaml:\d+: "):
        manifest.load(path)
