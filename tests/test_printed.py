"""Every command that the README and the book print is typed word for word in a clone, with relative paths."""

import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import yaml
from conftest import DRIVE, REPOSITORY, copy_book, imported_by, tiny_manifest, write_drive, write_images, write_manifest

from artifact import manifest
from artifact.book import build, runner
from artifact.suppression.compiled import compiled

NOTEBOOKS = ("tab01", "tab03", "preview")
NOT_TYPED = {
    "make test": "it is what runs these tests",
    "make lab": "opens JupyterLab and waits",
    "make bench": "takes minutes; its parts have tests of their own",
    "make bench METHODS=all": "builds all eleven methods; its parts have tests of their own",
}


def printed(path, section=""):
    """The commands in the shell blocks of a text, or of a section of it, without their comments."""
    text = (REPOSITORY / path).read_text().partition(section)[2] if section else (REPOSITORY / path).read_text()
    text = text.partition("\n## ")[0] if section else text
    blocks = re.findall(r"^```bash\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    return [re.sub(r"\s+", " ", re.sub(r"\s+# .*", "", line)).strip() for line in lines if line.strip()]


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A clone with a space in its path, whose profile is small, with images and descriptors as the texts name them."""
    folder = tmp_path_factory.mktemp("a clone")
    copy_book(folder, NOTEBOOKS)
    toc = yaml.safe_load((folder / "book" / "_toc.yml").read_text())
    chapters = [{"file": f"executed/{name}"} for name in (*NOTEBOOKS[1:], "status")]
    toc = {
        "format": toc["format"],
        "root": "executed/tab01",
        "chapters": [*chapters, {"file": "new"}, {"file": "references"}],
    }
    (folder / "book" / "_toc.yml").write_text(yaml.safe_dump(toc))
    for file in ("Makefile", "environment.txt", "pyproject.toml"):
        shutil.copy(REPOSITORY / file, folder / file)
    write_drive(folder, 30)
    for name, brightness in (("night", -50), ("day", 0)):
        write_images(folder / "photos" / name, 30, seed=9, brightness=brightness)
    entries = yaml.safe_load((REPOSITORY / "data_manifest.yaml").read_text())
    entries["datasets"]["drive"] = DRIVE
    entries["profiles"]["demo"] |= {"datasets": ["drive"], "methods": ["thumbnail", "hog"], "parameters": {}}
    readme = (REPOSITORY / "README.md").read_text()
    (folder / "my_method.py").write_text(re.search(r"```python\n(# my_method.py.*?)```", readme, re.DOTALL)[1])
    entry = re.search(r"```yaml\n# data_manifest.yaml, under methods:\n(.*?)```", readme, re.DOTALL)[1]
    entries["methods"] |= yaml.safe_load(entry)
    write_manifest(folder, entries)
    rng = np.random.default_rng(0)
    for name in "qd":
        np.save(folder / f"{name}.npy", rng.normal(size=(60, 16)).astype(np.float32))
        rows = "".join(f"{name}{i}.jpg,{i * 10},0\n" for i in range(60))
        (folder / f"{name}.csv").write_text(f"image,x,y\n{rows}")
    ready = folder / ".venv" / "bin"
    ready.mkdir(parents=True)
    (ready / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    (ready / "python").chmod(0o755)
    (folder / ".venv" / ".ready").write_text(f"{folder}\n")
    return folder


# They need the published archives; test_obtaining.py types those that lead to verified traversals.
NOT_TYPED |= dict.fromkeys(printed("README.md", "\n## The full paper\n"), "needs the archives")
# They need the results of a paper run; test_results.py exports, imports and recomputes those of a small one.
NOT_TYPED |= dict.fromkeys(printed("README.md", "\n## Many machines\n"), "needs a paper run")


def typed(clone, command):
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ARTIFACT_", "MAKE"))}
    done = subprocess.run(
        command, shell=True, cwd=clone, env=environment, capture_output=True, text=True, check=False, timeout=1200
    )
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


def commands():
    """All printed commands, each once, in an order in which what one needs is there."""
    every = dict.fromkeys([*printed("README.md"), *printed("book/new.md")])
    first = ["make reproduce", next(command for command in every if "data add" in command)]
    last = ["make book", "make verify", "make clean"]
    return [*first, *(c for c in every if c not in (*first, *last, *NOT_TYPED)), *last]


def test_every_command_runs_as_printed(clone):
    output = {command: typed(clone, command) for command in commands()}
    assert set(NOT_TYPED) <= {*printed("README.md"), *printed("book/new.md")}
    assert "my_town/dataset.yaml and my_town/preview.html written" in output[commands()[1]]
    evaluated = next(text for command, text in output.items() if command.endswith("evaluate --datasets my_town"))
    assert "30 queries (all evaluated), 30 database images" in evaluated
    assert re.search(r"my_town +hog +100.00 +100.00 +100.00 +30 +real images", evaluated)
    suppressed = next(text for command, text in output.items() if "--suppress INLP LEACE STD" in command)
    assert suppressed.count("STD") == 3
    assert not (clone / "book" / "_build").exists(), "make clean is the last"
    assert (clone / "q_leace.npy").exists()


# -- set-up on other people's machines ------------------------------------------------------------------------------


def made(folder, *arguments, **environment):
    """Run make in a folder with the repository's Makefile."""
    for file in ("Makefile", "environment.txt", "pyproject.toml"):
        if not (folder / file).exists():
            shutil.copy(REPOSITORY / file, folder / file)
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "ARTIFACT_CACHE") and not name.startswith("MAKE")
    }
    return subprocess.run(
        ["make", *arguments],
        cwd=folder,
        env=clean | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )


def test_an_environment_that_was_moved_is_made_again(tmp_path):
    assert "creating .venv" in made(tmp_path, "-n", "status").stdout
    ready = tmp_path / ".venv" / ".ready"
    ready.parent.mkdir()
    ready.write_text(f"{tmp_path}\n")
    assert "creating" not in made(tmp_path, "-n", "status").stdout
    ready.write_text("/somewhere/else\n")
    assert "creating .venv" in made(tmp_path, "-n", "status").stdout


def test_set_up_takes_the_index_that_is_asked_for(tmp_path):
    plain = made(tmp_path, "-n", "setup").stdout
    assert re.search(r"pip install .*torch==[\d.]+ *$", plain, re.MULTILINE)
    asked = made(tmp_path, "-n", "setup", "TORCH_INDEX=https://example.org/cpu").stdout
    assert re.search(r"torch==[\d.]+ --index-url https://example.org/cpu$", asked, re.MULTILINE)


def test_a_machine_without_a_driver_is_told_of_the_small_build(tmp_path):
    """The line of the recipe, run with and without what it looks for."""
    recipe = made(tmp_path, "-n", "setup").stdout
    line = re.search(r'test -n "" .*?\(0\.2 GB\)"', recipe, re.DOTALL)[0]
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "uname").write_text("#!/bin/sh\necho Linux\n")
    (tools / "uname").chmod(0o755)
    for driver in (False, True):
        if driver:
            (tools / "nvidia-smi").symlink_to(tools / "uname")
        done = subprocess.run(
            ["/bin/sh", "-c", line], env={"PATH": str(tools)}, capture_output=True, text=True, check=True
        )
        assert ("TORCH_INDEX=URL" in done.stdout) != driver


def test_set_up_compiles_what_kernels_import(tmp_path):
    assert re.search(r"-m compileall .*\bsrc .venv/lib\b", made(tmp_path, "-n", "setup").stdout)


# Does what set-up asks of a Python, without a network: what it is asked is written to a file, and an environment takes a while.
STUB = """#!/bin/sh
echo "$*" >> "{log}"
case "$*" in
*ensurepip*|*fcntl*|*sys*) exec "{python}" "$@" ;;
*venv*) mkdir -p .venv/bin; cp "$0" .venv/bin/python; sleep 2 ;;
esac
"""


def stub(folder, cases=""):
    """Write a Python that does no more than set-up needs, and what further cases say; it and the file of what it is asked."""
    python, log = folder / "python", folder / "asked"
    python.write_text(STUB.replace("*venv*)", f"{cases}*venv*)").format(log=log, python=sys.executable))
    python.chmod(0o755)
    return python, log


def test_of_two_set_ups_at_once_the_second_waits_and_finds_all_done(tmp_path):
    python, log = stub(tmp_path)
    arguments = "setup", f"PYTHON={python}"
    with ThreadPoolExecutor(2) as executor:
        done = list(executor.map(lambda _: made(tmp_path, *arguments, PATH="/usr/bin:/bin"), range(2)))
    assert [one.returncode for one in done] == [0, 0], [one.stderr for one in done]
    asked = log.read_text()
    assert asked.count("-m venv --clear .venv") == 1
    assert len(re.findall(r"-m pip install .*torch==", asked)) == 1
    said = sorted("waiting for it" in one.stdout for one in done)
    assert said == [False, True]
    assert "creating" not in made(tmp_path, *arguments).stdout  # an environment that is there is left alone


def test_set_up_fails_if_not_all_is_installed_and_waits_for_what_it_started(tmp_path):
    cases = '*environment.txt*) exit 3 ;;\n*artifact_city*) sleep 2; echo "compiled" >> "{log}" ;;\n'
    python, log = stub(tmp_path, cases)
    assert made(tmp_path, "setup", f"PYTHON={python}", PATH="/usr/bin:/bin").returncode != 0
    assert log.read_text().splitlines()[-1] == "compiled"
    assert not (tmp_path / ".venv" / ".ready").exists()


def test_what_cannot_be_compiled_is_said_and_set_up_goes_on(tmp_path):
    python, _ = stub(tmp_path, "*artifact_city*|*artifact.ranking*|*compileall*) exit 1 ;;\n")
    done = made(tmp_path, "setup", f"PYTHON={python}", PATH="/usr/bin:/bin")
    assert done.returncode == 0
    assert done.stdout.count("it is compiled at first use") == 2
    assert (tmp_path / ".venv" / ".ready").exists()


def test_the_renderer_is_compiled_as_soon_as_what_it_imports_is_there(tmp_path):
    recipe = made(tmp_path, "-n", "setup").stdout
    command = re.search(r"^awk .*(?= > )", recipe, re.MULTILINE)[0]
    kept = subprocess.run(["/bin/sh", "-c", command], cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    whole = (REPOSITORY / "environment.txt").read_text()
    assert all(block in whole for block in re.split(r"^(?=\S)", kept, flags=re.MULTILINE))
    files = (REPOSITORY / "src" / "artifact_city").rglob("*.py")
    imported = {name.partition(".")[0] for path in files for name in imported_by(path)}
    needed = {"pillow" if name == "PIL" else name for name in imported - {*sys.stdlib_module_names, "artifact_city"}}
    assert needed | {"llvmlite"} == set(re.findall(r"^\w+", kept, re.MULTILINE))


def test_the_makefile_is_read_by_the_make_of_macos():
    """Version 3.81 knows none of these."""
    text = (REPOSITORY / "Makefile").read_text()
    newer = r"^\.ONESHELL|^\w+ *!=|\$\(file |^undefine|::=|:::=|^private|\$\(guile|^load |\$\(intcmp|\$\(let "
    assert not re.search(newer, text, re.MULTILINE)


def test_a_clone_that_cannot_be_written_builds_its_book_in_the_cache(tmp_path, monkeypatch):
    (tmp_path / "clone" / "book" / "_build").mkdir(parents=True)
    (tmp_path / "clone" / "book" / "_toc.yml").write_text("root: a")
    (tmp_path / "clone" / "book" / "_build" / "old.html").write_text("")
    write_manifest(tmp_path / "clone", tiny_manifest())
    monkeypatch.setenv("ARTIFACT_CACHE", str(tmp_path / "cache"))
    loaded = manifest.load(tmp_path / "clone" / "data_manifest.yaml")
    assert build.source_folder(loaded) == tmp_path / "clone" / "book"
    monkeypatch.setattr(os, "access", lambda path, mode: "clone" not in str(path))
    source = build.source_folder(loaded)
    assert source == tmp_path / "cache" / "book"
    assert [path.name for path in source.iterdir()] == ["_toc.yml"]


def test_kernels_write_nothing_to_a_home_that_cannot_be_written(tmp_path, monkeypatch):
    write_manifest(tmp_path, tiny_manifest())
    monkeypatch.setenv("HOME", "/nonexistent")
    monkeypatch.delenv("ARTIFACT_CACHE", raising=False)
    with runner.environment_of_kernels(manifest.load(tmp_path / "data_manifest.yaml")):
        places = [os.environ[name] for name in ("IPYTHONDIR", "MPLCONFIGDIR", "JUPYTER_RUNTIME_DIR", "NUMBA_CACHE_DIR")]
    assert all(place.startswith(str(tmp_path / ".cache")) for place in places)


def test_inner_loops_compile_where_nothing_can_be_kept(monkeypatch):
    def unwritable(*_):
        raise RuntimeError("no locator available")

    monkeypatch.setattr("numba.core.dispatcher.Dispatcher.enable_caching", unwritable)
    assert compiled()(lambda x: x + 1)(1) == 2


SCRIPT = ["src/artifact/commands/doctor.py"]


@pytest.fixture
def doctor(tmp_path):
    """A folder with the one file that `make doctor` runs."""
    script = tmp_path / "src" / "artifact" / "commands" / "doctor.py"
    script.parent.mkdir(parents=True)
    shutil.copy(REPOSITORY / "src" / "artifact" / "commands" / "doctor.py", script)
    return tmp_path


def test_the_doctor_finds_nothing_wrong_or_says_what_is(doctor):
    done = made(doctor, "doctor")
    assert (done.returncode, done.stdout[:16]) == (0, "nothing is wrong")
    done = made(doctor, "doctor", PYTHONPATH="/elsewhere")
    assert done.returncode != 0
    assert "PYTHONPATH is set to '/elsewhere'" in done.stdout
    (doctor / "a file").touch()
    done = made(doctor, "doctor", ARTIFACT_CACHE=str(doctor / "a file"))
    assert "a file cannot be written" in done.stdout
    (doctor / ".git").mkdir()
    done = subprocess.run(
        [sys.executable, *SCRIPT], cwd=doctor, env={"PATH": ""}, capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith("git is not found: pages cannot say which commit")
    broken = doctor / ".venv" / "bin" / "python"
    broken.parent.mkdir(parents=True)
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    assert "the environment is broken; delete it and run make setup" in made(doctor, "doctor").stdout
