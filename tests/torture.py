"""Runs that are killed at any step of their writes, disks that are full, files that are damaged: nothing wrong, nothing lost.

``python tests/torture.py`` makes a small project with a rendered drive, photographs, a two-stage method, a notebook and a book. Runs of
``reproduce`` on it are killed, and run again until they are done; then its stored files are damaged in every way, and it is evaluated,
run and repaired. Whatever happens, the results must be the bytes of an undisturbed run, what was finished must not be made
again, and no process may end in a traceback.

All runs are the command line's own, in processes forked from this one, which has imported everything. There, a notebook's
cells run in the process of the run, and the book is built by copying its pages: kernels and Sphinx take seconds to start.
"""

import argparse
import contextlib
import errno
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
sys.path.insert(0, str(Path(__file__).parent))

import made_in_parts
import nbformat
import papermill
import torch
from conftest import HOG, STREET, tiny_manifest, write_images, write_manifest

import artifact_city
from artifact import datasets, manifest, store, studies  # noqa: F401
from artifact.book import build
from artifact.commands import cli, verify  # noqa: F401
from artifact.datasets import appearance  # noqa: F401
from artifact.extraction import forward, jobs, parts, reading  # noqa: F401

CITY = {
    "title": "Town",
    "kind": "city",
    "threshold": {"value": 1, "unit": "frames"},
    "query": "day",
    "database": "rain",
    "traversals": {
        name: {
            "condition": name,
            "render": {
                "town": 4,
                "route": "A2-D2-D4",
                "condition": weather,
                "frames": 3,
                "seed": 1,
                "positions": "frames",
            },
        }
        for name, weather in (("day", "sun"), ("rain", "rain"))
    },
}
NOTEBOOK = """# %% [markdown]
# # Numbers
# %% tags=["parameters"]
profile = "demo"
datasets = None
methods = None
# %%
from artifact import manifest, studies
from artifact.datasets import load_traversal
from artifact.datasets.appearance import appearance
loaded = manifest.load()
entry = loaded.profile(profile)
print(studies.recall.recall_table(loaded, entry.datasets, entry.methods).table[["dataset", "method", "R", "DAR"]].to_csv())
print(appearance(load_traversal(loaded, "street", "day"), loaded.cache).sum())
"""
STEPS = {"open", "os.rename", "os.remove", "os.mkdir", "os.chmod", "os.rmdir", "shutil.rmtree", "tempfile.mkstemp"}
CACHE = ".cache"


def make_project(folder):
    """Write the project's own files."""
    for name, brightness in (("day", 0), ("night", -40)):
        write_images(folder / "data" / "street" / name, 8, seed=1, brightness=brightness)
    content = tiny_manifest(street=STREET, town=CITY)
    own = {"title": "Both", "builder": "made_in_parts:Both", "code_bits": 16, "rerank": 2, "batch_size": 4}
    content["methods"] = {"hog": HOG, "both": HOG | own | {"batch_dependent": True}}
    content["profiles"]["demo"]["methods"] = ["hog", "both"]
    write_manifest(folder, content)
    (folder / "notebooks").mkdir()
    (folder / "notebooks" / "numbers.py").write_text(NOTEBOOK)
    (folder / "book").mkdir()
    (folder / "book" / "_toc.yml").write_text("root: executed/numbers\n")


def run_cells(source, target, parameters=None, **_):
    """Execute a notebook in this process."""
    notebook, names, lines = nbformat.read(source, as_version=4), dict(parameters or {}), []
    for cell in (cell for cell in notebook.cells if cell.cell_type == "code"):
        names["print"] = lambda *values: lines.append(" ".join(map(str, values)))
        exec(cell.source, names) if "parameters" not in cell.metadata.get("tags", []) else None
    notebook.cells[-1].outputs = [nbformat.v4.new_output("stream", text="\n".join(lines))]
    nbformat.write(notebook, target)


def copy_pages(source):
    """Build a book by copying its pages."""
    html = source / "_build" / "html"
    html.mkdir(parents=True, exist_ok=True)
    for page in (source / "executed").glob("*.ipynb"):
        (html / f"{page.stem}.html").write_text(page.read_text())
        (html / "index.html").write_text(page.name)


class Fault:
    """What goes wrong in a process: killed or out of disk at a step of its writes, or when a file gets a size."""

    def __init__(self, kind, at):
        self.kind, self.at, self.seen = kind, at, 0

    def begin(self, project):
        """Let it happen from now on, to files of the project."""
        if self.kind.endswith("size"):
            handler = signal.SIG_DFL if self.kind == "kill size" else signal.SIG_IGN
            signal.signal(signal.SIGXFSZ, handler)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.at, resource.RLIM_INFINITY))
            return
        fsync = os.fsync
        os.fsync = lambda handle: (self.step(), fsync(handle))
        sys.addaudithook(lambda event, found: self.step() if self.counts(event, found, str(project)) else None)

    def counts(self, event, found, project):
        """Whether an event is a write below the project."""
        if event not in STEPS or not str(found[0]).startswith(project):
            return False
        return event != "open" or bool(found[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))

    def step(self):
        """Count a step, and fail at the one that was drawn and, where the disk is full, at all that follow."""
        self.seen += 1
        if self.kind == "kill step" and self.seen == self.at:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.kind == "full step" and self.seen >= self.at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def run(project, *commands, fault=None):
    """Run commands in a forked process; return its exit status (negative: the signal) and what it printed."""
    ours, theirs = os.pipe()  # to which limits of files do not apply
    child = os.fork()
    if child == 0:
        status = 70
        with contextlib.suppress(BaseException):
            os.dup2(theirs, 1), os.dup2(theirs, 2)
            sys.stdout, sys.stderr = os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
            os.chdir(project)
            patch()
            try:
                if fault is not None:
                    fault.begin(project)
                status = max(cli.main(command) for command in commands)
            except BaseException:
                import traceback

                traceback.print_exc()
        os._exit(status)
    os.close(theirs)
    with os.fdopen(ours, errors="replace") as stream:
        text = stream.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text


def patch():
    """Nothing that takes long to start; what was written just now counts as settled, as it would after two seconds."""
    papermill.execute_notebook, build._build_strictly = run_cells, copy_pages
    reading.default_workers = lambda *_: 0
    made_in_parts.BATCH_SECONDS, parts._BATCHES, store._SETTLED = 0, 1, -1
    torch.set_num_threads(1)


def results(project):
    """Bytes of all results, by their place."""
    kept = (".npy", ".npz", ".jpg", ".csv", ".ipynb", ".html")
    places = [*(project / CACHE).rglob("*"), *(project / "book").rglob("*")]
    found = {p.relative_to(project): p for p in places if p.suffix in kept and p.is_file()}
    left = re.compile(r"/\.|\.damaged|\.unfinished")  # hidden, or set aside
    return {name: p.read_bytes() for name, p in found.items() if not left.search(f"/{'/'.join(name.parts[1:])}")}


def finished(project):
    """The whole results in the cache, with their inode: made again, a file would have another."""
    found = {}
    for place in (project / CACHE).rglob("*.json"):
        for path in (place.with_suffix(ending) for ending in (".npy", ".npz", ".ipynb")):
            with contextlib.suppress(store.StoreError, OSError):
                if ".parts" not in str(path) and store.check(path):
                    found[path] = path.stat().st_ino
    return found


def kinds(project):
    """All stored files by their kind: the folder in which they are, and their ending."""
    found = {}
    for top in (project / CACHE, project / "book"):
        for path in sorted(p for p in top.rglob("*") if p.is_file() and p.suffix != ".lock" and p.name != "_toc.yml"):
            kind = path.relative_to(project).parts[1], path.suffix or path.name
            found.setdefault(kind, []).append(path)
    return found


def damage(path, others, draw):
    """Damage a file in one of several ways; return which."""
    content, how = path.read_bytes(), draw.choice(["bit", "cut", "emptied", "another type", "noise", "swapped", "gone"])
    if how == "bit" and content:
        place = draw.randrange(len(content))
        content = content[:place] + bytes([content[place] ^ 1 << draw.randrange(8)]) + content[place + 1 :]
    elif how == "cut":
        content = content[: draw.randrange(max(1, len(content)))]
    elif how == "another type":
        content = draw.choice([b"[1, 2]", b"null", b'"text"', b"{}", b"\x93NUMPY", b"PK\x03\x04", b"\xff\xd8\xff"])
    elif how == "swapped":
        other = draw.choice(others)
        content, theirs = other.read_bytes(), content
        other.write_bytes(theirs)
    else:
        content = b"" if how == "emptied" else draw.randbytes(len(content))
    path.write_bytes(content)
    if how == "gone":
        path.unlink()
    return how


class Trial:
    """All trials on one project, and what was found."""

    def __init__(self, folder, seed):
        self.draw, self.folder, self.count = random.Random(seed), folder, Counter()
        self.project, self.faults = folder / "project", []
        self.project.mkdir()
        make_project(self.project)
        artifact_city.render(
            artifact_city.CityTraversal(**CITY["traversals"]["day"]["render"]), folder / "warm", workers=1
        )
        artifact_city.render(
            artifact_city.CityTraversal(**CITY["traversals"]["rain"]["render"]), folder / "warm2", workers=1
        )
        self.status, self.printed = self.ended(["evaluate"])
        status, text = self.ended(["reproduce"], ["verify"])
        assert (self.status, status) == (0, 0), self.printed + text
        self.right, self.whole = results(self.project), folder / "whole"
        shutil.copytree(self.project, self.whole)

    def ended(self, *commands, fault=None):
        """Run commands, and note a traceback."""
        status, text = run(self.project, *map(list, commands), fault=fault)
        if "Traceback" in text or status == 70:
            self.note(f"a traceback in {commands} ({fault and (fault.kind, fault.at)}):\n{text[-3000:]}")
        return status, text

    def note(self, fault):
        """Keep and show what went wrong."""
        self.faults.append(fault)
        sys.stdout.write(f"FAULT {fault}\n")

    def anew(self, whole):
        """Begin with the whole project, or with one in which nothing has run."""
        shutil.rmtree(self.project)
        shutil.copytree(self.whole, self.project, symlinks=True)
        if not whole:
            for built in (CACHE, "book/executed", "book/_build"):
                shutil.rmtree(self.project / built)

    def compare(self, what, needed=lambda name: True):
        """Note results that are not those of the undisturbed run; some may be absent, if nobody needed them again."""
        found = results(self.project)
        names = found.keys() | {name for name in self.right if needed(name)}
        if odd := sorted(str(name) for name in names if found.get(name) != self.right.get(name)):
            self.note(f"wrong after {what}: {odd}")

    def interrupted(self):
        """One run, interrupted again and again until it is done; each interruption is a kill point."""
        self.anew(whole=False)
        history = []
        while True:
            kind = self.draw.choices(["kill step", "kill size", "full step", "full size"], [6, 2, 2, 1])[0]
            at = self.draw.randint(1, 60) if kind.endswith("step") else int(2 ** self.draw.uniform(4, 14))
            before = finished(self.project)
            fault = None if len(history) > 60 else Fault(kind, at)
            status, text = self.ended(["reproduce"], fault=fault)
            after = finished(self.project)
            if lost := [str(path) for path, inode in before.items() if after.get(path) != inode]:
                self.note(f"lost by {kind} {at} after {history}: {lost}")
            if status == 0:
                break
            history.append(f"{kind} {at}")
            self.count[kind] += 1
            if status == 1 and not re.search(r"^error: .*|No space|too large", text, re.MULTILINE):
                self.note(f"no line of {kind} {at}: {text[-500:]}")
        self.compare(f"{history}")

    def damaged(self):
        """One stored file damaged: evaluated, run, and what nobody has read repaired."""
        self.anew(whole=True)
        named = kinds(self.project)
        kind = self.draw.choice(sorted(named))
        path = self.draw.choice(named[kind])
        how = damage(path, named[kind], self.draw)
        what = f"{how}: {path.relative_to(self.project)}"
        self.count["damaged " + "/".join(kind)] += 1
        status, text = self.ended(["evaluate"])
        if status or not text.endswith(self.printed[self.printed.index(" title") :]):
            self.note(f"evaluated otherwise after {what}: {text[-2000:]}")
        status, text = self.ended(["reproduce"])
        if status:
            self.note(f"did not run after {what}: {text[-2000:]}")
        if self.ended(["verify"])[0]:
            self.count["repaired"] += 1
            if self.ended(["verify", "--repair"])[0]:
                self.note(f"not repaired after {what}")
        self.compare(what, lambda name: name.parts[0] == "book")


def main():
    """Do what is asked for, print what was done, and return the number of faults."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--kills", type=int, default=1000, help="interruptions (default: 1000)")
    options.add_argument("--damages", type=int, default=500, help="damaged files (default: 500)")
    options.add_argument("--seed", type=int, default=0)
    asked, begun = options.parse_args(), time.monotonic()
    for variable in ("ARTIFACT_CACHE", "ARTIFACT_DATA_ROOT"):
        os.environ.pop(variable, None)
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder), asked.seed)
        while sum(n for kind, n in trial.count.items() if kind.startswith(("kill", "full"))) < asked.kills:
            trial.interrupted()
        for _ in range(asked.damages):
            trial.damaged()
    for kind, number in sorted(trial.count.items()):
        sys.stdout.write(f"{number:6} {kind}\n")
    sys.stdout.write(f"{len(trial.faults)} faults in {time.monotonic() - begun:.0f} s\n")
    return min(1, len(trial.faults))


if __name__ == "__main__":
    sys.exit(main())
