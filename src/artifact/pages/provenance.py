"""What made a page: parameters, inputs with their keys, code revision, machine and time."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import join, markup, table
from artifact.pages.scope import Page

MADE_BY = "<!-- made by -->"
"""Where the run of a book puts the command that makes the page and links to the functions that computed it."""


def provenance(page: Page, *studies: Any) -> HTML:
    """Show what made this page: parameters as settled, the ``inputs`` of each study, code revision, machine, time.

    The metadata of the box names the stored results that the page read until now.
    """
    inputs = pd.DataFrame([record for study in studies for record in study.inputs]).drop_duplicates()
    facts = {
        "Code": code_revision(),
        "Run": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "Machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
    }
    box = markup(
        '<details class="provenance"><summary>Provenance: command, functions, parameters, inputs, time</summary>{}'
        "<ul>{}</ul><ul>{}</ul>{}</details>",
        HTML(MADE_BY),
        join(markup("<li><code>{} = {!r}</code></li>", *item) for item in page.parameters.items()),
        join(markup("<li>{}: {}</li>", *item) for item in facts.items()),
        table(inputs, numeric=["images"]) if len(inputs) else markup("<p>No descriptors are used here.</p>"),
    )
    box.metadata = {"results": list(dict.fromkeys(page.manifest.results))}
    return box


def code_revision() -> str:
    """Return the package version and, in a git checkout, the commit and whether files differ from it."""
    release, folder = f"artifact {version('artifact')}", Path(__file__).resolve().parents[3]
    described = ["describe", "--always", "--exclude=*", "--abbrev=12", "--dirty= with local changes"]
    try:
        done = subprocess.run(["git", "-C", folder, *described], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        return release
    return f"{release}, commit {done.stdout.strip()}"
