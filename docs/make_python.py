"""Makes `python_names.md` from the docstrings of what `import rig` offers: `python docs/make_python.py`."""

import ast
import inspect
from collections.abc import Iterator
from pathlib import Path

import rig

PAGE = Path(__file__).resolve().parent / "python_names.md"
WIDEST = 90


def page() -> str:
    """Return the page."""
    lines = [
        "# Names of import rig",
        "",
        "Made from the docstrings by `python docs/make_python.py`; a test holds the two together.",
        "[In Python](python.md) shows how the names are used.",
    ]
    for name in sorted(rig.__all__, key=str.lower):
        lines += ["", f"## {name}", "", *_described(getattr(rig, name))]
    return "\n".join(lines) + "\n"


def _described(thing: type) -> list[str]:
    (node,) = ast.parse(inspect.getsource(thing)).body
    if isinstance(node, ast.FunctionDef):
        return ["```python", _signature(node), "```", "", *_told(node)]
    assert isinstance(node, ast.ClassDef)  # noqa: S101 - a script's own
    fields = [ast.unparse(part) for part in node.body if _is_field(part)]
    shown = ["```python", *fields, "```", ""] if fields else []
    members = [line for member in _members(node) for line in member]
    return [*shown, *_told(node), "", *members] if members else [*shown, *_told(node)]


def _is_field(node: ast.stmt) -> bool:
    return isinstance(node, ast.AnnAssign) and not ast.unparse(node.target).startswith("_")


def _members(owner: ast.ClassDef) -> Iterator[list[str]]:
    """What a class offers beside its fields: methods and properties, a point of a list each."""
    for node in owner.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and ast.get_docstring(node):
            is_value = any("property" in ast.unparse(d) for d in node.decorator_list)
            shown = node.name if is_value else " ".join(_signature(node, method=True).split())
            yield [f"- `{shown}`: " + " ".join(" ".join(_told(node)).split())]


def _signature(node: ast.FunctionDef, method: bool = False) -> str:
    """A function's first line as it is written, a parameter a line where it is long."""
    arguments = ast.unparse(node.args).removeprefix("self").removeprefix(", ")
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    name = node.name if method else f"rig.{node.name}"
    line = f"{name}({arguments}){returns}".replace("'", '"')
    if len(line) <= WIDEST or method:
        return line
    each = [ast.unparse(part) for part in _parameters(node.args)]
    return "\n".join([f"{name}(", *(f"    {part}," for part in each), f"){returns}"]).replace("'", '"')


def _parameters(all_of: ast.arguments) -> Iterator[ast.expr]:
    """Each parameter with its default, as expressions that can be written out."""
    plain = [*all_of.posonlyargs, *all_of.args]
    defaults = [None] * (len(plain) - len(all_of.defaults)) + list(all_of.defaults)
    pairs = [*zip(plain, defaults, strict=True)]
    star = [(ast.arg("*"), None)] if all_of.kwonlyargs else []
    for argument, default in (*pairs, *star, *zip(all_of.kwonlyargs, all_of.kw_defaults, strict=True)):
        text = ast.unparse(argument) + ("" if default is None else f" = {ast.unparse(default)}")
        yield ast.Name(text)


def _told(node: ast.FunctionDef | ast.ClassDef) -> list[str]:
    return (ast.get_docstring(node) or "").splitlines()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
