"""Every command that the README and the book print is typed word for word in a clone, with relative paths."""

import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
import yaml
from conftest import DRIVE, REPOSITORY, write_images, write_manifest

NOTEBOOKS = ("tab01", "tab03", "preview")
NOT_TYPED = {
    "make test": "it is what runs these tests",
    "make bench": "takes minutes; its parts have tests of their own",
    "make bench METHODS=all": "builds all eleven methods; its parts have tests of their own",
}


def printed(path):
    """The commands in the shell blocks of a text, without their comments."""
    blocks = re.findall(r"^```bash\n(.*?)^```", (REPOSITORY / path).read_text(), re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    return [re.sub(r"\s+", " ", re.sub(r"\s+# .*", "", line)).strip() for line in lines if line.strip()]


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A clone with a space in its path, whose profile is small, with images and descriptors as the texts name them."""
    folder = tmp_path_factory.mktemp("a clone")
    for part in ("notebooks", "book"):
        shutil.copytree(
            REPOSITORY / part, folder / part, ignore=shutil.ignore_patterns("_build", "executed", "__pycache__")
        )
    for path in (folder / "notebooks").glob("*.py"):
        if path.stem not in NOTEBOOKS:
            path.unlink()
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
    for name, brightness in (("day", 0), ("night", -70), ("dusk", -20), ("night_2", -71)):
        write_images(folder / "data" / "drive" / name, 30, seed=4, brightness=brightness, noise=25)
        rows = [f"frame{i}.png,{12.0 * i + abs(brightness) / 20:.1f},0" for i in range(30)]
        (folder / "data" / "drive" / name / "positions.csv").write_text("\n".join(["image,x,y", *rows]) + "\n")
    for name, brightness in (("night", -50), ("day", 0)):
        write_images(folder / "photos" / name, 30, seed=9, brightness=brightness)
    manifest = yaml.safe_load((REPOSITORY / "data_manifest.yaml").read_text())
    manifest["datasets"]["drive"] = DRIVE
    manifest["profiles"]["demo"] |= {"datasets": ["drive"], "methods": ["thumbnail", "hog"], "parameters": {}}
    readme = (REPOSITORY / "README.md").read_text()
    (folder / "my_method.py").write_text(re.search(r"```python\n(# my_method.py.*?)```", readme, re.DOTALL)[1])
    entry = re.search(r"```yaml\n# data_manifest.yaml, under methods:\n(.*?)```", readme, re.DOTALL)[1]
    manifest["methods"] |= yaml.safe_load(entry)
    write_manifest(folder, manifest)
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


def typed(clone, command):
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ARTIFACT_", "MAKE"))}
    done = subprocess.run(
        command, shell=True, cwd=clone, env=environment, capture_output=True, text=True, check=False, timeout=600
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
        timeout=60,
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
    broken = doctor / ".venv" / "bin" / "python"
    broken.parent.mkdir(parents=True)
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    assert "the environment is broken; delete it and run make setup" in made(doctor, "doctor").stdout
