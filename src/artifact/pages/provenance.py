"""What made a page: parameters, inputs with their keys, code revision, machine and time."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import join, markup, table
from artifact.pages.scope import Page


class Recorded(Protocol):
    """Anything that knows the records of its inputs."""

    @property
    def inputs(self) -> tuple[dict[str, Any], ...]:
        """One record per traversal and method."""


def provenance(page: Page, *studies: Recorded) -> HTML:
    """Show what made this page: every parameter of the notebook as settled, inputs, code revision, machine and time."""
    inputs = pd.DataFrame([record for study in studies for record in study.inputs]).drop_duplicates()
    facts = {
        "Code": code_revision(),
        "Run": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "Machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
    }
    return markup(
        '<details class="provenance"><summary>Provenance: parameters, inputs, code, time</summary>'
        "<ul>{}</ul><ul>{}</ul>{}</details>",
        join(markup("<li><code>{} = {!r}</code></li>", *item) for item in page.parameters.items()),
        join(markup("<li>{}: {}</li>", *item) for item in facts.items()),
        table(inputs, numeric=["images"]) if len(inputs) else markup("<p>No descriptors are used here.</p>"),
    )


def code_revision() -> str:
    """Return the package version and, in a git checkout, the commit and whether files differ from it."""
    release = version("artifact")
    folder = Path(__file__).resolve().parents[3]
    try:
        commit = _git(folder, "rev-parse", "--short=12", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return f"artifact {release}"
    return f"artifact {release}, commit {commit}{' with local changes' if changed else ''}"


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *arguments], check=True, capture_output=True, text=True)
    return done.stdout.strip()
