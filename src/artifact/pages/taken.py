"""A page to leaf through the queries that distractors take; it works from a file, without a network."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Titles, in_unit, markup, table
from artifact.pages.galleries import encoded, picture
from artifact.studies.evaluated import Measured
from artifact.studies.per_query import COLUMNS

_WIDTH, _QUALITY = 200, 68  # of a picture: pixels, and that of its JPEG


def columns_table() -> HTML:
    """Say what the columns of the tables of queries hold."""
    return table([{"Column": name, "Holds": text} for name, text in COLUMNS.items()])


def browser(found: Mapping[tuple[str, str], tuple[Measured, pd.DataFrame]], titles: Titles) -> HTML:
    """Show one query at a time: the query, the positive that should have won, and the distractor that did.

    ``found`` are results of :func:`artifact.studies.per_query.taken` by dataset and method. Filters choose dataset and method;
    the arrow keys go on. Datasets whose images are not here are left out. The images are embedded once each.
    """
    images: dict[str, str] = {}
    cases: list[dict[str, Any]] = []
    for (name, method), (measured, rows) in found.items():
        data = measured.dataset
        if not (data.query.has_images and data.database.has_images):
            continue
        for row in rows.to_dict("records"):
            case = {"dataset": data.title, "method": titles[method], "of": row["of"]}
            for part, traversal in (("query", data.query), ("positive", data.database), ("distractor", data.query)):
                key = f"{name}/{traversal.name}/{row[part]}"
                if key not in images:
                    image = picture(traversal, row[part])
                    image.thumbnail((_WIDTH, _WIDTH))
                    images[key] = encoded(image, _QUALITY)
                case[part], case[f"{part}_file"] = key, traversal.image_names[row[part]]
            away = in_unit(row["away"], data.unit)
            case["note"] = f"{away} from the query; with distractors its place has rank {row['rank_with_distractors']}"
            case |= {"query_condition": data.query.condition, "database_condition": data.database.condition}
            cases.append(case)
    if not cases:
        return markup("<p>No query of this run is taken by a distractor, or no images are on this machine.</p>")
    # A script element ends at the first "</": nothing in the data may spell it.
    content = json.dumps({"images": images, "cases": cases}).replace("<", "\\u003c")
    script = (files("artifact.pages") / "taken.js").read_text(encoding="utf-8")
    return HTML(
        '<div class="taken" tabindex="0"><p><label>Dataset <select class="dataset"></select></label> '
        '<label>Method <select class="method"></select></label> <button class="previous" type="button">← previous</button> '
        '<button class="next" type="button">next →</button> <span class="count" aria-live="polite"></span></p>'
        '<div class="triple"></div>'
        f'<script type="application/json">{content}</script><script>{script}</script></div>'
    )
