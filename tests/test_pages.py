"""Parts of pages: text from outside is escaped, claims speak of the run's K, a page settles what it shows."""

import re

import pandas as pd
import pytest
from conftest import REPOSITORY
from matplotlib.figure import Figure

from artifact import manifest, pages
from artifact.manifest.entries import ManifestError
from artifact.pages.common import claim, markup
from artifact.pages.scope import NothingToShowError, Page
from artifact.studies.judging import Judged

HOSTILE = "<img src=x onerror=alert(1)>"


def recall_rows():
    values = {"R": 90.0, "DAR": 45.0, "RSR": 50.0}
    bounds = {f"{metric}_{side}": value for metric, value in values.items() for side in ("low", "high")}
    missing = {f"reported_{metric}": float("nan") for metric in values}
    facts = {"queries": 20, "listed": 20, "hits_R": 18, "hits_DAR": 9, "reported_as": None, "origin": HOSTILE}
    return pd.DataFrame(
        [
            {"dataset": name, "title": HOSTILE, "method": "m", **values, **bounds, **missing, **facts}
            for name in ("one", "two")
        ]
    )


def test_text_from_manifest_and_folders_is_escaped_everywhere():
    rows, titles = recall_rows(), {"m": HOSTILE}
    judged = Judged("cannot tell", HOSTILE)
    finding = claim("tab03", HOSTILE, paper=HOSTILE, rule=HOSTILE)(lambda: (HOSTILE, judged))()
    shown = [
        pages.recall.recall_table(rows, titles, label=HOSTILE),
        pages.recall.beside_reported(rows, titles),
        pages.recall.scatter(rows, titles),
        pages.common.table([{HOSTILE: HOSTILE}], caption=HOSTILE, classes=HOSTILE),
        pages.common.label(HOSTILE),
        pages.common.download(rows, HOSTILE),
        pages.common.findings(finding),
        pages.common.findings_table([finding]),
        pages.composition.fitting_order([HOSTILE], rows),
        pages.opening.headline(rows, titles),
        pages.style.embed(Figure(), f'"{HOSTILE}'),
        markup("{}{x}", HOSTILE, x=HOSTILE),
    ]
    for html in shown:
        assert "<img src=x" not in html.data
        without_data = re.sub(r"base64,[\w+/=]*", "", html.data)
        assert not re.search(r'="[^"]*"[^>\s/"]', without_data)
        assert "&amp;lt;" not in html.data, "escaped twice"


def test_two_datasets_of_the_same_title_keep_their_columns():
    html = pages.recall.recall_table(recall_rows(), {"m": "M"}, label="").data
    assert html.count('<th colspan="3"') == 3
    assert html.count("<td") == 9


def test_claims_name_the_k_of_the_run_and_the_evidence_that_of_the_paper():
    @claim("tab03", "DAR@K below R@K", paper="R@1 falls", rule="R@K > DAR@K")
    def below(k=1):
        return f"at {k}", Judged("agrees", "it does")

    assert (below().claim, below(k=5).claim) == ("DAR@1 below R@1", "DAR@5 below R@5")
    assert (below(5).rule, below(5).paper, below(5).found) == ("R@5 > DAR@5", "R@1 falls", "at 5")


def page_of(profile, **asked):
    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    entry = loaded.profile(profile)
    methods = (asked["method"],) if asked.get("method") else tuple(entry.methods)
    return Page(loaded, profile, tuple(entry.datasets), methods, asked)


def test_a_page_of_one_method_takes_none_that_reranks():
    page = page_of("paper", dataset=None, method=None, seed=3)
    assert page.choose().method == "selavprpp"
    chosen = page.choose(unit="metres", single_stage=True)
    assert chosen.parameters == {"profile": "paper", "dataset": "robotcar", "method": "salad_cm", "seed": 3}
    with pytest.raises(ManifestError, match="method 'selavpr': this page needs a method that does not re-rank"):
        page_of("paper", dataset=None, method="selavpr").choose(single_stage=True)


def test_a_page_that_nothing_suits_says_what_it_needs():
    with pytest.raises(NothingToShowError, match="a threshold in furlongs; no dataset of profile 'demo' is one"):
        page_of("demo", dataset=None).choose(unit="furlongs")


def test_a_page_without_datasets_still_has_parameters():
    assert page_of("demo", datasets=None, places=5).only().parameters == {
        "profile": "demo",
        "datasets": (),
        "places": 5,
    }
