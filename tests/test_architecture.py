"""Data flows one way: no module imports from a later stage, none imports in a circle, and the town knows no artifact."""

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import imported_by

SOURCE = Path(__file__).resolve().parents[1] / "src"
STAGES = (
    "manifest",
    "store",
    "datasets",
    "methods",
    "extraction",
    "suppression",
    "ranking",
    "metrics",
    "studies",
    "pages",
    "book",
    "commands",
)
MODULES = {
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(SOURCE.rglob("*.py"))
}


def imports_of(module):
    """Modules of this repository that a module imports, at its top or inside a function."""
    found = {name if name in MODULES else name.rpartition(".")[0] for name in imported_by(MODULES[module])}
    return {name for name in found if name in MODULES}


IMPORTS = {module: imports_of(module) for module in MODULES}


def stage(module):
    return STAGES.index(module.split(".")[1])


def test_the_folder_listing_is_the_architecture():
    listed = {p.stem for p in (SOURCE / "artifact").iterdir() if not p.name.startswith("__")}
    assert listed == set(STAGES)


@pytest.mark.parametrize("module", [m for m in MODULES if m.startswith("artifact.") and m != "artifact.__main__"])
def test_no_module_imports_from_a_later_stage(module):
    later = [m for m in IMPORTS[module] if m.startswith("artifact.") and stage(m) > stage(module)]
    assert not later


def test_no_module_imports_in_a_circle():
    # A package and what it only re-exports (`from artifact.studies import recall`) do not make a circle.
    graph = {
        module: {other for other in others if not module.startswith(f"{other}.") and not other.startswith(f"{module}.")}
        for module, others in IMPORTS.items()
    }
    done, path = set(), []

    def visit(module):
        assert module not in path, " → ".join([*path[path.index(module) :], module])
        if module not in done:
            path.append(module)
            for other in graph[module]:
                visit(other)
            path.pop()
            done.add(module)

    for module in graph:
        if module != "artifact":
            visit(module)


def test_the_town_imports_nothing_of_the_library():
    assert not [
        (module, other)
        for module in MODULES
        if module.split(".")[0] == "artifact_city"
        for other in IMPORTS[module]
        if other.split(".")[0] == "artifact"
    ]


def test_a_page_that_shows_stored_results_does_not_wait_for_torch():
    code = "import sys; from artifact import pages, studies; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_formatter_decides_everywhere():
    mark = "# fmt" + ": "
    files = [path for part in ("src", "tests", "notebooks", "book") for path in (SOURCE.parent / part).rglob("*.py")]
    assert [str(path) for path in files if mark in path.read_text(encoding="utf-8")] == []
