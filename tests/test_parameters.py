"""Unknown or invalid parameters are errors before anything runs."""

import argparse
import ast
import re
import warnings

import jupytext
import papermill
import pytest
from conftest import REPOSITORY

from artifact import manifest
from artifact.book import parameters
from artifact.book.parameters import ParameterError
from artifact.commands import arguments, cli
from artifact.commands.arguments import asked_parameters
from artifact.pages.scope import open_page

NOTEBOOK = """
# %% tags=["parameters"]
profile = "demo"
dataset = None
methods = None
k = 1
seed = 0
ratios = [0, 0.5, 1]
distances = [25, 50]
title = "plain"
scale = 1.0

# %%
print(k)
"""


@pytest.fixture
def notebook(project):
    (project / "notebooks").mkdir()
    path = project / "notebooks" / "tab99.py"
    path.write_text(NOTEBOOK)
    return path


@pytest.fixture
def loaded(project):
    return manifest.load(project / "data_manifest.yaml")


def test_defaults_are_read_from_the_tagged_cell(notebook):
    assert parameters.read(notebook) == {
        "profile": "demo",
        "dataset": None,
        "methods": None,
        "k": 1,
        "seed": 0,
        "ratios": [0, 0.5, 1],
        "distances": [25, 50],
        "title": "plain",
        "scale": 1.0,
    }


def test_asked_values_replace_defaults(notebook, loaded):
    merged = parameters.merged(notebook, {"k": 5, "dataset": "street", "methods": ["hog"], "scale": 2}, loaded)
    assert (merged["k"], merged["dataset"], merged["methods"], merged["scale"], merged["seed"]) == (
        5,
        "street",
        ["hog"],
        2,
        0,
    )


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"kk": 5}, "unknown parameter 'kk'; allowed: profile, dataset, methods, k"),
        ({"k": 0}, "k is 0; allowed: whole numbers from 1"),
        ({"k": 1.5}, "k is 1.5; allowed: whole numbers from 1"),
        ({"k": True}, "k is True; allowed: whole numbers from 1"),
        ({"seed": -1}, "seed is -1; allowed: whole numbers from 0"),
        ({"profile": "full"}, "profile is 'full'; allowed: 'demo'"),
        ({"profile": ["demo"]}, "profile is ['demo']; allowed: 'demo'"),
        ({"methods": [["hog"]]}, "['hog']: allowed: 'thumbnail', 'hog'"),
        ({"dataset": "avenue"}, "dataset is 'avenue'; allowed: 'street', or the path of a folder"),
        ({"dataset": ["street"]}, "allowed: 'street', or the path of a folder"),
        ({"methods": ["hog", "vlad"]}, "'vlad': allowed: 'thumbnail', 'hog'"),
        ({"methods": []}, "allowed: one name, several with commas, a list of names, or None"),
        ({"methods": "hog, vlad"}, "'vlad': allowed: 'thumbnail', 'hog'"),
        ({"methods": 3}, "allowed: one name, several with commas, a list of names, or None"),
        ({"ratios": [0, 2]}, "allowed: a list of numbers from 0 to 1"),
        ({"ratios": []}, "allowed: a list of numbers from 0 to 1"),
        ({"distances": ["far"]}, "allowed: a list of numbers from 0 to inf"),
        ({"title": 3}, "allowed: a value of type str, as the default 'plain'"),
        ({"scale": "wide"}, "allowed: a value of type float"),
    ],
)
def test_bad_values_name_notebook_parameter_and_what_is_allowed(notebook, loaded, asked, message):
    with pytest.raises(ParameterError) as caught:
        parameters.merged(notebook, asked, loaded)
    assert str(caught.value).startswith("notebooks/tab99.py: ")
    assert message in str(caught.value)


def test_names_are_one_several_with_commas_or_a_list(notebook, loaded):
    for asked in ("hog", ["hog"]):
        assert parameters.merged(notebook, {"methods": asked}, loaded)["methods"] == ["hog"]
    assert parameters.merged(notebook, {"methods": "hog, thumbnail"}, loaded)["methods"] == ["hog", "thumbnail"]


OPENS_A_PAGE = """
# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---
# %% tags=["parameters"]
profile: str = "demo"  # a profile
methods: list[str] = None  # names
k: int = 1  # from 1

# %%
from artifact.pages.scope import open_page

page = open_page(profile, methods=methods, k=k)
"""


class Shell:
    """A notebook in which papermill set what it was given."""

    def __init__(self, **given):
        lines = [f"{name} = {value!r}" for name, value in given.items()]
        self.user_ns = {"In": ["", "k: int = 1", "\n".join(["# Parameters", *lines]), "unrelated = 3"]}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kk": 5}, "unknown parameter 'kk'; allowed: profile, methods, k"),
        ({"k": 0}, "k is 0; allowed: whole numbers from 1"),
        ({"methods": "hog, vlad"}, "'vlad': allowed: 'thumbnail', 'hog'"),
    ],
)
def test_a_page_checks_its_parameters_itself(project, monkeypatch, given, message):
    monkeypatch.chdir(project)
    monkeypatch.setattr("artifact.pages.parameters.get_ipython", lambda: Shell(**given))
    values = {name: given.get(name, default) for name, default in (("methods", None), ("k", 1))}
    with pytest.raises(ParameterError, match=re.escape(message)):
        open_page("demo", **values)


def test_a_page_takes_one_name_or_several_with_commas(project, monkeypatch):
    monkeypatch.chdir(project)
    assert open_page("demo", methods="hog").methods == ("hog",)
    page = open_page("demo", methods="hog,thumbnail", datasets=None)
    assert page.parameters["methods"] == page.methods == ("hog", "thumbnail")


def test_papermill_itself_fails_for_an_unknown_parameter(project):
    (project / "notebooks").mkdir()
    notebook = project / "notebooks" / "tab99.ipynb"
    jupytext.write(jupytext.reads(OPENS_A_PAGE.lstrip(), "py:percent"), notebook)
    paths = str(notebook), str(project / "out.ipynb")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the Jupyter packages themselves
        with pytest.raises(papermill.exceptions.PapermillExecutionError, match="unknown parameter 'kk'"):
            papermill.execute_notebook(*paths, {"kk": 5}, kernel_name="python3", cwd=project, progress_bar=False)


def test_papermill_shows_type_and_range_of_every_parameter(tmp_path):
    for path in sorted((REPOSITORY / "notebooks").glob("*.py")):
        jupytext.write(jupytext.read(path), tmp_path / "one.ipynb")
        shown = papermill.inspect_notebook(str(tmp_path / "one.ipynb"))
        assert list(shown) == list(parameters.read(path)), path.name
        for name, found in shown.items():
            assert found["inferred_type_name"] != "None", (path.name, name)
            assert found["help"], (path.name, name)


def test_all_faults_are_listed(notebook, loaded):
    with pytest.raises(ParameterError) as caught:
        parameters.merged(notebook, {"k": 0, "seed": -1, "colour": 2}, loaded)
    assert len(str(caught.value).splitlines()) == 3


def test_a_folder_may_be_a_dataset(notebook, loaded, project):
    with pytest.raises(ParameterError, match="expected one folder named queries or query, found 0"):
        parameters.merged(notebook, {"dataset": str(project)}, loaded)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("k = 1 + n", "the default of 'k' is not a literal"),
        ("import os", "line 1 of the parameters cell is not 'name: type = literal'"),
        ("a = b = 1", "is not 'name: type = literal'"),
        ("k: int", "is not 'name: type = literal'"),
    ],
)
def test_parameter_cells_hold_plain_assignments(notebook, cell, message):
    notebook.write_text(f'# %% tags=["parameters"]\n{cell}\n')
    with pytest.raises(ParameterError, match=message):
        parameters.read(notebook)
    notebook.write_text("# %%\nk = 1\n")
    with pytest.raises(ParameterError, match="0 cells are tagged 'parameters'; allowed: exactly one"):
        parameters.read(notebook)


def test_command_line_values_are_yaml():
    assert asked_parameters(["k=5", "fig06.ratios=[0, .5]", "tab03.datasets=[a,b]", "dataset=null"]) == {
        "*": {"k": 5, "dataset": None},
        "fig06": {"ratios": [0, 0.5]},
        "tab03": {"datasets": ["a", "b"]},
    }
    for text in ("k", "=3", ".k=3", "fig06.=3", "k=[1"):
        with pytest.raises(ParameterError):
            asked_parameters([text])


def test_every_notebook_of_the_book_has_good_parameters():
    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    notebooks = sorted((REPOSITORY / "notebooks").glob("*.py"))
    assert len(notebooks) >= 9
    for path in notebooks:
        assert parameters.merged(path, {}, loaded) == parameters.read(path)


def test_every_notebook_hands_all_its_parameters_to_its_page():
    for path in sorted((REPOSITORY / "notebooks").glob("*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        named = {ast.unparse(call.func): call for call in calls}
        if not parameters.read(path):
            continue
        opened = named["open_page"]
        handed = [ast.unparse(argument) for argument in opened.args]
        handed += [keyword.arg for keyword in opened.keywords if keyword.arg == ast.unparse(keyword.value)]
        assert handed == list(parameters.read(path)), path.name
        assert ast.unparse(named["pages.provenance.provenance"].args[0]) == "page", path.name


def test_every_command_that_is_read_is_carried_out():
    def commands(parser):
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for sub in action.choices.values():
                    yield sub.get_default("command")
                    yield from commands(sub)

    with_actions = {"results", "suppress"}  # commands that are nothing without one
    assert set(commands(arguments.parser())) - with_actions == set(cli._COMMANDS)
