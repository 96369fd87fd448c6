"""Shared fixtures: a tiny project folder with its own manifest, images and cache."""

import ast
import copy
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

collect_ignore = ["mutants.py"]  # a program of maintainers, which needs the extra of that name

REPOSITORY = Path(__file__).resolve().parents[1]

THUMBNAIL = {
    "title": "Thumbnail",
    "kind": "baseline",
    "backbone": "–",
    "aggregation": "thumbnail",
    "dimension": 512,
    "batch_size": 4,
    "preprocessing": {"resize": "fixed", "size": [16, 32], "colour": "grey", "mean": [0.0], "std": [1.0]},
}
HOG = {
    "title": "HOG",
    "kind": "baseline",
    "backbone": "–",
    "aggregation": "HOG",
    "dimension": 108,
    "batch_size": 5,
    "preprocessing": {"resize": "fixed", "size": [32, 64], "colour": "grey", "mean": [0.0], "std": [1.0]},
}


def imported_by(path):
    """Yield the full names of all that a Python file imports, at its top or inside a function."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from (".".join(filter(None, (getattr(node, "module", None), alias.name))) for alias in node.names)


def write_images(folder, n, seed, *, brightness=0.0, noise=12.0, suffix=".png"):
    """Images of n places: smooth random scenes, the same for the same seed, with noise and another brightness."""
    folder.mkdir(parents=True, exist_ok=True)
    scenes, sensor = np.random.default_rng(seed), np.random.default_rng([seed, int(100 + brightness)])
    for index in range(n):
        scene = np.kron(scenes.uniform(40, 215, (6, 8, 3)), np.ones((8, 8, 1)))
        pixels = scene + brightness + sensor.normal(0, noise, scene.shape)
        Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8)).save(folder / f"frame{index}{suffix}")


def tiny_manifest(**datasets):
    return copy.deepcopy(_tiny_manifest(datasets))


def _tiny_manifest(datasets):
    return {
        "version": 1,
        "data_root": "data",
        "datasets": datasets
        or {
            "street": {
                "title": "Street",
                "kind": "folder",
                "threshold": {"value": 1, "unit": "frames"},
                "query": "day",
                "database": "night",
                "traversals": {"day": {"condition": "day"}, "night": {"condition": "night"}},
            }
        },
        "methods": {"thumbnail": THUMBNAIL, "hog": HOG},
        "profiles": {
            "demo": {"description": "tiny", "datasets": list(datasets or ["street"]), "methods": ["thumbnail", "hog"]}
        },
    }


def write_manifest(folder, content):
    path = folder / "data_manifest.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def no_settings_from_outside(monkeypatch, request):
    """Tests see no data root and no cache of the machine, but for those that ask for the real data."""
    if "data" not in request.keywords:
        monkeypatch.delenv("ARTIFACT_DATA_ROOT", raising=False)
    monkeypatch.delenv("ARTIFACT_CACHE", raising=False)


@pytest.fixture
def project(tmp_path):
    """A folder with a manifest, two traversals of twelve images, and nothing else."""
    write_images(tmp_path / "data" / "street" / "day", 12, seed=1)
    write_images(tmp_path / "data" / "street" / "night", 12, seed=1, brightness=-35)
    write_manifest(tmp_path, tiny_manifest())
    return tmp_path


def real_data_root():
    root = os.environ.get("ARTIFACT_DATA_ROOT")
    return Path(root) if root and (Path(root) / "gardens_point" / "day_right").is_dir() else None


# Files that use one project, which only one process then has to make; and those that take long, which start first.
SHARED = {"tests/test_journey.py": "tests/test_book.py"}
LONGEST = ["test_book", "test_journey", "test_rehearsal", "test_printed", "test_results", "test_cluster"]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            file = super()._split_scope(nodeid)
            return SHARED.get(file, file)

    return Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))
    skip = pytest.mark.skip(
        reason="needs the Gardens Point images: set ARTIFACT_DATA_ROOT to the folder that holds gardens_point/"
    )
    for item in items:
        if "data" in item.keywords and real_data_root() is None:
            item.add_marker(skip)


DRIVE = {
    "title": "Drive",
    "kind": "folder",
    "threshold": {"value": 25, "unit": "metres"},
    "query": "day",
    "database": "night",
    "shift": "day→night",
    "distractor_traversals": ["dusk", "night_2"],
    "same_condition_traversal": "dusk",
    "irrelevant_pairs": [["day", "dusk"]],
    "traversals": {
        "day": {"condition": "day"},
        "night": {"condition": "night"},
        "dusk": {"condition": "dusk"},
        "night_2": {"condition": "night"},
    },
}
STREET = {
    "title": "Street",
    "kind": "folder",
    "threshold": {"value": 1, "unit": "frames"},
    "query": "day",
    "database": "night",
    "traversals": {"day": {"condition": "day"}, "night": {"condition": "night"}},
}


def artifact(project, *arguments, **variables):
    """Run the command line in the project, with further environment variables; returns status and output."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ARTIFACT_")} | variables
    command = [sys.executable, "-m", "artifact", *arguments]
    done = subprocess.run(
        command, cwd=project, env=environment, capture_output=True, text=True, check=False, timeout=1200
    )
    return done.returncode, done.stdout + done.stderr


def copy_book(project, pages=None):
    """Copy the notebooks, all or those named, and the book's own files, without what was built from them."""
    for part in ("notebooks", "book"):
        built = shutil.ignore_patterns("_build", "executed", "__pycache__")
        shutil.copytree(REPOSITORY / part, project / part, ignore=built)
    for path in (project / "notebooks").glob("*.py"):
        if pages is not None and path.stem not in pages:
            path.unlink()


def flip(path):
    """Change one bit in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def write_drive(project, n):
    """Write the images and positions of the dataset :data:`DRIVE`."""
    for name, brightness in (("day", 0), ("night", -70), ("dusk", -20), ("night_2", -71)):
        folder = project / "data" / "drive" / name
        write_images(folder, n, seed=4, brightness=brightness, noise=25)
        rows = [f"frame{i}.png,{12.0 * i + abs(brightness) / 20:.1f},0" for i in range(n)]
        (folder / "positions.csv").write_text("\n".join(["image,x,y", *rows]) + "\n")


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """A project folder in which `reproduce` has run once; with what it printed."""
    project = tmp_path_factory.mktemp("tiny")
    copy_book(project)
    write_drive(project, 40)
    for name, brightness in (("day", 0), ("night", -60)):
        write_images(project / "data" / "street" / name, 30, seed=6, brightness=brightness, noise=25)
    write_manifest(project, tiny_manifest(drive=DRIVE, street=STREET))
    status, output = artifact(project, "reproduce", "--jobs", "2")
    assert status == 0, output
    return project, output


@pytest.fixture(scope="session")
def browser():
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:  # continuous integration must not skip these tests
        told = pytest.fail if os.environ.get("ARTIFACT_REQUIRE_BROWSER") else pytest.skip
        told("needs Chromium; on Debian: apt install chromium")
    with sync_playwright() as playwright:
        options = [
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
        ]
        chromium = playwright.chromium.launch(executable_path=program, args=options)
        yield chromium
        chromium.close()
