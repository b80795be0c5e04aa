"""A user's program as statements: calls, assignments, branches and loops.

URScript's expressions are written as Python's, so Python's own parser reads them; its blocks end with a
line `end`. Threads and functions of the program's own are left out as a whole.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.errors import InputError

LONGEST_LINE = 10_000
DEEPEST = 50
_OPENING = re.compile(r"(if|while|for|def|thread|sec)\b(.*):$")
_ELSE = re.compile(r"(elif|else)\b(.*):$")


@dataclass(frozen=True, slots=True)
class Left:
    """What is not carried out; `text` is its first line."""

    text: str


@dataclass(frozen=True, slots=True)
class Do:
    """A call or an assignment."""

    text: str
    node: ast.Call | ast.Assign


@dataclass(frozen=True, slots=True)
class While:
    """A loop."""

    text: str
    condition: ast.expr
    body: "tuple[Statement, ...]"


@dataclass(frozen=True, slots=True)
class If:
    """Branches in order: each a condition (None for else) and what is done."""

    text: str
    branches: "tuple[tuple[ast.expr | None, tuple[Statement, ...]], ...]"


Statement = Left | Do | While | If


def parse_statements(lines: tuple[str, ...]) -> tuple[Statement, ...]:
    """Read a program's body. Raises `InputError` where blocks are nested too deep."""
    return _block(iter(lines), 0)[0]


def parse_line(line: str) -> ast.Call | ast.Assign | None:
    """A line of a program as a call or an assignment; None for anything else."""
    node = _parsed(re.sub(r"^(global|local)\s+", "", line.strip()))
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        return node.value
    return node if isinstance(node, ast.Assign) else None


def _block(lines: Iterator[str], depth: int) -> tuple[tuple[Statement, ...], str]:
    """Statements up to the line that ends their block, and that line ("" at the program's end)."""
    if depth > DEEPEST:
        raise InputError(f"script: blocks are nested deeper than {DEEPEST}")
    statements: list[Statement] = []
    for line in lines:
        if line == "end" or _ELSE.match(line):
            return tuple(statements), line
        opening = _OPENING.match(line)
        statements.append(_opened(line, opening, lines, depth) if opening else _single(line))
    return tuple(statements), ""


def _single(line: str) -> Statement:
    node = parse_line(line)
    return Left(line) if node is None else Do(line, node)


def _opened(line: str, opening: re.Match[str], lines: Iterator[str], depth: int) -> Statement:
    keyword, rest = opening.groups()
    if keyword == "if":
        return _if(line, rest, lines, depth)
    body, _ = _block(lines, depth + 1)
    condition = _condition(rest)
    return While(line, condition, body) if keyword == "while" and condition else Left(line)


def _if(line: str, condition: str, lines: Iterator[str], depth: int) -> Statement:
    branches: list[tuple[ast.expr | None, tuple[Statement, ...]]] = []
    understood, at = True, _condition(condition)
    while True:
        understood = understood and (at is not None or condition == "")
        body, closing = _block(lines, depth + 1)
        branches.append((at, body))
        following = _ELSE.match(closing)
        if following is None:
            return If(line, tuple(branches)) if understood else Left(line)
        condition = following[2].strip()
        at = _condition(condition)


def _condition(text: str) -> ast.expr | None:
    node = _parsed(text.strip())
    return node.value if isinstance(node, ast.Expr) else None


def _parsed(text: str) -> ast.stmt | None:
    if len(text) > LONGEST_LINE:
        return None
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    return body[0] if len(body) == 1 else None
