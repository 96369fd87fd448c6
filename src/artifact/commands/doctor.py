"""``make doctor``: what set-up needs, checked in a second with the standard library alone.

It runs before anything is installed, as a script.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

_NEEDED_GB = 3.0
_ROOT = Path(__file__).resolve().parents[3]


def faults() -> Iterator[str]:
    """Yield what is wrong, one line each, with what to do."""
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        yield f"Python is {sys.version.split()[0]}: 3.11, 3.12 or 3.13 is needed; name it with PYTHON=/path/to/python"
    for module in ("venv", "ensurepip"):
        if importlib.util.find_spec(module) is None:
            yield f"Python has no module {module}; on Debian and Ubuntu: apt install python3-venv"
    if (_ROOT / ".git").exists() and shutil.which("git") is None:
        yield "git is not found: pages cannot say which commit made them; all else works"
    if not (_ROOT / ".venv" / ".ready").exists():
        yield from _folder_faults(_ROOT, "clone to another place")
    cache = Path(os.environ.get("ARTIFACT_CACHE", _ROOT / ".cache")).expanduser()
    yield from _folder_faults(cache, "set ARTIFACT_CACHE to a folder that can be written")
    python = _ROOT / ".venv" / "bin" / "python"
    if (
        python.exists()
        and subprocess.run([python, "-c", "import artifact, torch"], capture_output=True, check=False).returncode
    ):
        yield f"{python.parents[1]}: the environment is broken; delete it and run make setup"
    for variable in ("PYTHONPATH", "PYTHONHOME"):
        if os.environ.get(variable):
            yield f"{variable} is set to {os.environ[variable]!r}, which can hide installed packages; unset it"


def _folder_faults(folder: Path, advice: str) -> Iterator[str]:
    there = next(parent for parent in (folder, *folder.parents) if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        yield f"{there} cannot be written ({error.strerror}); {advice}"
        return
    free = shutil.disk_usage(there).free / 1e9
    if free < _NEEDED_GB:
        yield f"{there}: {free:.1f} GB free; set-up and the demo need about {_NEEDED_GB:.0f} GB"


def main() -> int:
    """Print what is wrong, or that nothing is; return 1 if anything is."""
    found = list(faults())
    for line in found or [f"nothing is wrong: Python {sys.version.split()[0]}, {_ROOT}"]:
        sys.stdout.write(f"{line}\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
