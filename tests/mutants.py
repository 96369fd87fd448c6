"""Mutation run: small changes of the library, one at a time, that tests of their area must notice.

``make mutants`` (needs the extra ``mutants``) samples changes of each area, at most one for each place in the code, and runs
that area's tests against each in a process of its own; no file is changed. A change that no test notices survives. Survivors
that change nothing that anyone is promised stand in ``mutants.csv`` with the reason (without ``after``: whatever the change of
the line); another survivor is a test to write.
"""

import argparse
import ast
import csv
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import cosmic_ray.ast
import cosmic_ray.mutating
import cosmic_ray.plugins
import mutated

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src" / "artifact"
AREAS = {
    "store": ("store.py", ["store", "crashes", "keys"]),
    "suppression": ("suppression/*.py", ["splits", "suppressed", "suppression"]),
    "metrics": ("metrics/*.py", ["statistics", "keys", "ranking", "suppression", "rerank"]),
    "extraction": ("extraction/*.py", ["crashes", "keys", "parts", "extract", "given", "rerank", "planning"]),
    "ranking": ("ranking/*.py", ["ranking", "suppression", "rerank", "exactness"]),
}
BINARY = [
    "Add_Sub",
    "Sub_Add",
    "Mul_Div",
    "Div_Mul",
    "FloorDiv_Mul",
    "Mod_Mul",
    "Pow_Mul",
    "BitOr_BitAnd",
    "BitAnd_BitOr",
]
COMPARISONS = ["Eq_NotEq", "NotEq_Eq", "Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Lt_Gt", "Gt_Lt", "Is_IsNot", "IsNot_Is"]
OPERATORS = [
    *(f"ReplaceBinaryOperator_{kind}" for kind in BINARY),
    *(f"ReplaceComparisonOperator_{kind}" for kind in COMPARISONS),
    *(
        "AddNot",
        "ExceptionReplacer",
        "NumberReplacer",
        "ReplaceAndWithOr",
        "ReplaceOrWithAnd",
        "ReplaceBreakWithContinue",
    ),
    *("ReplaceContinueWithBreak", "ReplaceFalseWithTrue", "ReplaceTrueWithFalse", "ReplaceUnaryOperator_Delete_Invert"),
    *("ReplaceUnaryOperator_Delete_Not", "ReplaceUnaryOperator_Delete_USub", "ZeroIterationForLoop", "RemoveDecorator"),
]
_SLOW = "too slow"
# Imported once and not in every process: torch with all that a model needs, and what the book is made with.
HEAVY = [
    "torch.utils.data",
    "safetensors.torch",
    "pandas",
    "numba",
    "sklearn.linear_model",
    "sklearn.svm",
    "sklearn.metrics",
]
HEAVY += [
    "scipy.stats",
    "scipy.spatial",
    "scipy.special",
    "matplotlib.figure",
    "papermill",
    "jupytext",
    "PIL.Image",
    "tqdm",
]
HEAVY += ["pydantic", "yaml", "filelock", "hypothesis", "pytest"]


def meaning(code):
    """What of a module can change a result: its syntax tree without annotations and docstrings; none of no Python."""
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        for part in ("annotation", "returns"):
            if getattr(node, part, None) is not None:
                setattr(node, part, ast.Constant(None))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value = ast.Constant(None)
    return ast.dump(tree)


def mutants_of(path):
    """Return the changes of a module by place: line before, line after, whole text after."""
    code, found = path.read_text(encoding="utf-8"), {}
    nodes, original = list(walk(cosmic_ray.ast.get_ast(code))), meaning(code)
    for name in OPERATORS:
        operator = cosmic_ray.plugins.get_operator(f"core/{name}")()
        places = [place for node in nodes for place in operator.mutation_positions(node)]
        for occurrence, place in enumerate(places):
            try:
                changed = cosmic_ray.mutating.mutate_code(code, operator, occurrence)
            except AttributeError:  # an operator that meets what it does not expect
                continue
            if changed is not None and meaning(changed) not in (original, None):
                lines = [text.splitlines()[place[0][0] - 1].strip() for text in (code, changed)]
                found.setdefault(place, []).append((*lines, changed))
    return found


def say(line, stream=sys.stdout, end="\n"):
    stream.write(line + end)
    stream.flush()


def walk(node):
    yield node
    for child in getattr(node, "children", ()):
        yield from walk(child)


def passes(path, text, tests, limit):
    """Run tests in a process of its own in which a module has another text: whether all pass in time, and what they say.

    The processes that it starts have that text too: each runs ``sitecustomize`` when it starts.
    """
    with tempfile.TemporaryDirectory() as folder:
        changed = Path(folder) / path.name
        changed.write_text(text, encoding="utf-8")
        (Path(folder) / "sitecustomize.py").write_text(
            "import mutated\n\nmutated.install_as_in_parent()\n", encoding="utf-8"
        )
        child = os.fork()
        if child == 0:
            os.setsid()
            for stream in (1, 2):
                os.dup2(os.open(Path(folder) / "output", os.O_WRONLY | os.O_CREAT | os.O_APPEND), stream)
            os.environ["PYTHONPATH"] = os.pathsep.join(map(str, [folder, Path(__file__).parent, SOURCE.parent]))
            name = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)
            package = str(path.parent) if path.name == "__init__.py" else ""
            mutated.install(name.removesuffix(".__init__"), str(changed), package)
            os._exit(run_tests(tests))
        end = time.monotonic() + limit
        while time.monotonic() < end:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return status == 0, (Path(folder) / "output").read_text(encoding="utf-8")
            time.sleep(0.05)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return False, _SLOW


def run_tests(tests):
    import hypothesis
    import pytest

    hypothesis.settings.register_profile("mutants", database=None, derandomize=True)
    files = [f"tests/test_{name}.py" for name in tests]
    options = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-profile=mutants"]
    return int(pytest.main([*options, "-W", "ignore::pytest.PytestAssertRewriteWarning", *files]))


def known():
    with (Path(__file__).with_name("mutants.csv")).open(encoding="utf-8", newline="") as stream:
        return {(row["module"], row["before"], row["after"]): row["reason"] for row in csv.DictReader(stream)}


def run_area(area, sample, chance):
    """Try a sample of an area's changes, print each that survives; return how many were tried, survived and are unknown."""
    pattern, tests = AREAS[area]
    places = [(path, found) for path in sorted(SOURCE.glob(pattern)) for found in mutants_of(path).values()]
    chosen = chance.sample(places, min(sample or len(places), len(places)))
    begun, unchanged = time.monotonic(), SOURCE / "__init__.py"
    passed, output = passes(unchanged, unchanged.read_text(encoding="utf-8"), tests, 3600)
    if not passed:
        sys.exit(f"{area}: the tests fail without any change:\n{output[-3000:]}")
    limit, survived, unknown, slow, reasons = 3 * (time.monotonic() - begun) + 30, 0, 0, 0, known()
    for number, (path, variants) in enumerate(chosen, start=1):
        before, after, text = chance.choice(variants)
        passed, output = passes(path, text, tests, limit)
        slow += output == _SLOW
        if passed:
            survived += 1
            module = str(path.relative_to(SOURCE))
            reason = reasons.get((module, before, after)) or reasons.get((module, before, ""))
            unknown += reason is None
            say(f"{module}: {before}  ->  {after}  ({reason or 'NOT LISTED'})")
        say(f"{area} {number}/{len(chosen)}: {survived} survive", sys.stderr, "\r")
    say(f"{area}: {survived} of {len(chosen)} changes survive, sampled from {len(places)} places; {slow} took too long")
    return len(chosen), survived, unknown


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("areas", nargs="*", help=f"of {', '.join(AREAS)} (default: all)")
    parser.add_argument("--sample", type=int, default=40, help="changes tried in each area; 0 tries one at every place")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    os.chdir(REPOSITORY)
    sys.path.insert(0, str(REPOSITORY / "src"))
    for name in HEAVY:
        __import__(name)
    found = [run_area(area, options.sample, random.Random(options.seed)) for area in options.areas or AREAS]
    tried, survived, unknown = map(sum, zip(*found, strict=True))
    changing = tried - (survived - unknown)
    say(
        f"{tried - survived} of {tried} changes are noticed, {survived - unknown} change nothing that anyone is promised;"
    )
    say(f"of the others {(tried - survived) / changing:.1%} are noticed, {unknown} are not and call for a test")
    sys.exit(int(unknown > 0))


if __name__ == "__main__":
    main()
