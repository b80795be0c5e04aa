"""Makes `messages.md`, the messages that name a cure, from the code: `python docs/make_messages.py`."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "messages.md"
FOLDERS = ("drivers", "calibration", "protocols", "rig")
AREAS = {
    "Arm": ("drivers/ur5e", "drivers/keep_out.py", "drivers/motion.py"),
    "Gripper": ("drivers/robotiq_3f",),
    "Fingertips and camera": ("drivers/video", "drivers/images.py", "drivers/tally.py"),
    "A lift": ("protocols", "rig/lift", "rig/experiments", "rig/live"),
    "Bench file": ("rig/config", "rig/bench"),
    "Calibrating": ("calibration", "rig/calibrate", "rig/cli/calibrate"),
    "Sessions, reports, results": ("rig/sessions", "rig/report", "rig/results", "rig/export"),
    "Frames, estimators, labels": ("rig/frames", "rig/tactile", "rig/labels"),
    "Benchmarks": ("rig/benchmark", "rig/cli/benchmark"),
    "Training": ("rig/training",),
    "Everything else": ("rig", "drivers"),
}
VERBS = (
    "add ask begin bring calibrate check choose clear click connect continue copy correct draw "
    "end export free give go install keep label leave load look make measure mend move name open "
    "pip press put record recover remove replug restart run save see segment set sort start "
    "switch take try turn unplug update use visit wait write zero "
).split()
_CURE = re.compile(rf"(?:; |: |\. |\? )((?:{'|'.join(VERBS)})\b.*)$", re.IGNORECASE | re.DOTALL)
_QUESTION = re.compile(r"; ([^;]*\?)$")
NOT_ERRORS = {"ValueError", "TypeError", "ArithmeticError", "KeyError"}


def messages() -> list[tuple[str, str, str]]:
    """Return each message that names a cure: its file, what was seen, what to do; `...` for what varies."""
    found = []
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for text in _errors(tree):
                if (parts := split(text)) is not None:
                    found.append((path.relative_to(ROOT).as_posix(), *parts))
    return found


def texts() -> set[str]:
    """Return every text in the code, `...` for each value put into it."""
    trees = (ast.parse(p.read_text(encoding="utf-8")) for f in FOLDERS for p in (ROOT / f).rglob("*.py"))
    return {text for tree in trees for node in ast.walk(tree) if (text := _text(node))}


def split(text: str) -> tuple[str, str] | None:
    """Split a message into what was seen and what to do; None where it names no cure."""
    match = _CURE.search(text) or _QUESTION.search(text)
    if match is None:
        return None
    seen, cure = text[: match.start()].strip(), match.group(1).strip()
    return (seen, cure) if seen.strip(". :") else None


def advice() -> dict[str, list[str]]:
    """Return what the doctor and the reports ask for, by where they say it."""
    return {
        "What rig doctor asks for": _told(sorted((ROOT / "rig" / "doctor").glob("*.py")), "todo"),
        "What a report advises": _told(sorted((ROOT / "rig" / "report").glob("*.py")), "advice"),
    }


def page() -> str:
    """Return the page."""
    lines = [
        "# Messages and their cures",
        "",
        "Made from the code by `python docs/make_messages.py`; a test holds the two together. `...` is for",
        "what differs. [Troubleshooting](troubleshooting.md) is for what you see without a message.",
    ]
    rows, done = messages(), set()
    for area, folders in AREAS.items():
        mine = [row for row in rows if row[0].startswith(folders) and row not in done]
        done.update(mine)
        cells = sorted({f"| {_cell(seen)} | {_cell(cure)} |" for _, seen, cure in mine}, key=str.lower)
        lines += ["", f"## {area}", "", "| message | what to do |", "|---|---|", *cells]
    for title, told in advice().items():
        lines += ["", f"## {title}", "", *(f"- {_cell(text)}" for text in told)]
    return "\n".join(lines) + "\n"


def _errors(tree: ast.AST) -> Iterator[str]:
    """Messages of the errors that a file raises."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node.args:
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            if name.endswith("Error") and name not in NOT_ERRORS and (text := _text(node.args[0])):
                yield text


def _told(paths: list[Path], name: str) -> list[str]:
    """Texts that are given a name in some files, such as `todo`."""
    found: dict[str, None] = {}
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Assign) and any(getattr(t, "id", "") == name for t in node.targets):
                texts = (
                    _text(part) for part in ast.walk(node.value) if not isinstance(part, ast.FormattedValue)
                )
                found.update({t: None for t in texts if t and len(t.split()) > 2})
    return [t for t in found if not any(t != other and t in other for other in found)]


def _text(node: ast.AST) -> str | None:
    """A text as it stands in the code, `...` for each value put into it; None for what is none."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(v) or "..." for v in node.values)
    return None


def _cell(text: str) -> str:
    """A text as a table's cell shows it."""
    plain = " ".join(text.split())
    for sign in "\\|*_[]<>`":
        plain = plain.replace(sign, "\\" + sign)
    return plain


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
