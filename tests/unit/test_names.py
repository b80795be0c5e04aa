"""A function that acts is named by a verb, one that asks by `is_`, `has_` or the noun of its answer."""

import ast
import subprocess
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")
IRREGULAR = set(
    "begun bent bound broken built caught chosen done drawn driven fallen fed felt found frozen given gone "
    "grown held hidden kept known laid led left lit lost made meant met paid said seen sent shown sought "
    "stood sunk swept taken thrown told torn understood won worn wound written".split()
)
"""Participles without -ed. Those that are also the verb (read, put, cut, split, spread) are fine."""
VERBS = {"embed", "exceed", "feed", "need", "proceed", "red", "seed", "shed", "speed", "succeed"}
"""Words that end in -ed and are no participles."""
COPY = "returns a changed copy of a value that never changes; a verb would read as a change in place"
ALLOWED = {
    "drivers/types.py:Pose.translated": COPY,
    "rig/tactile/slip/alignment.py:Pose.moved": COPY,
    "calibration/gel/look.py:GelLook.varied": COPY,
    "fakes/gel/variation.py:Look.varied": COPY,
    "calibration/gel/noise.py:CameraNoise.scaled": COPY,
    "rig/tactile/slip/compiled.py:compiled": "a decorator, which describes the function below it",
}


def is_participle(name: str) -> bool:
    word = name.strip("_")
    return word in IRREGULAR or ("_" not in word and word.endswith("ed") and word not in VERBS)


def functions(inside: ast.AST, where: str) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield each function, also inner ones, with its qualified name; properties are left out."""
    for node in ast.iter_child_nodes(inside):
        named = isinstance(node, ast.FunctionDef | ast.ClassDef)
        place = f"{where}{node.name}" if named else where
        if isinstance(node, ast.FunctionDef) and not any(map(is_property, node.decorator_list)):
            yield place, node
        yield from functions(node, f"{place}." if named else where)


def is_property(decorator: ast.expr) -> bool:
    return ast.unparse(decorator).endswith(("property", ".setter"))


def test_no_function_is_named_by_a_bare_participle() -> None:
    command = ["git", "ls-files", *(f"{package}/*.py" for package in PACKAGES)]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = {
        place
        for file in listed.stdout.split()
        for place, node in functions(ast.parse((ROOT / file).read_text(encoding="utf-8")), f"{file}:")
        if is_participle(node.name)
    }
    assert found == set(ALLOWED), "name it by a verb, or by is_, has_ or the noun of its answer"
