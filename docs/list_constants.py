"""Write the page of the experiment's constants from the source: `python docs/list_constants.py`.

The page has every public number of the modules in `TOPICS`, with the docstring below it as its text.
"""

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "constants.md"
TOPICS = {
    "Steps of a lift": (
        "protocols/steps.py", "protocols/slip_trial.py", "protocols/pump.py", "protocols/reaction.py",
        "protocols/safe_end.py", "protocols/readiness.py",
    ),
    "Plan and repetition of lifts and grips": (
        "rig/experiments/lift_plan.py", "rig/experiments/attempts.py", "rig/experiments/record.py",
        "protocols/record_grasps.py", "protocols/teach.py",
    ),
    "Motions of calibrations": (
        "protocols/capture_hand_eye.py", "protocols/capture_pivot.py", "protocols/capture_touch.py",
    ),
    "Settling and slip": (
        "rig/tactile/settling.py", "rig/lift/slip_watch.py", "rig/frames/slip_alarm.py", "rig/lift/onset.py",
    ),
    "Angle and result of a lift": (
        "rig/lift/object_angle.py", "rig/lift/measurement.py", "rig/lift/result.py", "rig/lift/agreement.py",
        "rig/results/metrics.py", "rig/results/scores.py", "rig/results/shares.py",
    ),
    "Devices": (
        "drivers/motion.py", "drivers/ur5e/arm.py", "drivers/ur5e/heartbeat.py",
        "drivers/robotiq_3f/gripper.py", "drivers/video/reader.py", "drivers/tally.py",
        "calibration/store.py", "rig/config/calibrations.py",
    ),
}  # fmt: skip
UNITS = {
    "_M_S2": "m/s²", "_M_S": "m/s", "_DEG_S": "deg/s", "_MS": "ms", "_NS": "s", "_S": "s", "_MM": "mm",
    "_M": "m", "_RAD": "rad", "_DEG": "deg", "_N": "N", "_KG": "kg", "_PX": "px", "_DAYS": "days",
}  # fmt: skip
"""Unit by the end of a name; times in ns are shown in s."""
HEAD = """# Constants of the experiment

After reading this page you know the speeds, times, thresholds and limits of the experiment, and the files in
which to change them. If no source of a value is stated, the value was chosen. The page is generated:
`python docs/list_constants.py` writes it again after a change.

[How slip works](slip.md) has the parameters of the estimator `slip`,
[formats](formats.md#bench-object-and-calibration-files) the files with the limits of a bench.
"""


def write_value(name: str, value: float) -> str:
    """Return a value with its unit."""
    unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
    return f"{value / 1e9 if name.endswith('_NS') else value:g} {unit}".strip()


def list_constants(file: str) -> Iterator[tuple[list[str], str]]:
    """Yield the public numbers of a module that stand above one docstring, and its first paragraph.

    Raises `SystemExit` for a public number without a docstring.
    """
    module = import_module(file.removesuffix(".py").replace("/", "."))
    statements = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    names: list[str] = []
    for statement, following in zip(statements, [*statements[1:], None], strict=True):
        if not isinstance(statement, ast.Assign):
            continue
        assigned = [node.id for node in ast.walk(statement.targets[0]) if isinstance(node, ast.Name)]
        names += [
            name for name in assigned if name.isupper() and isinstance(getattr(module, name), int | float)
        ]
        if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
            public = [name for name in names if not name.startswith("_")]
            if public:
                yield public, " ".join(str(following.value.value).split("\n\n")[0].split())
            names = []
        elif not isinstance(following, ast.Assign):
            if public := [name for name in names if not name.startswith("_")]:
                raise SystemExit(f"{file}: {', '.join(public)}: write the meaning into a docstring below")
            names = []


def make_page() -> str:
    """Return the text of the page."""
    lines = [HEAD]
    for topic, files in TOPICS.items():
        lines.append(f"## {topic}\n")
        for file in files:
            module = import_module(file.removesuffix(".py").replace("/", "."))
            lines += [
                f"`{file}`:\n",
                "| constant | value | meaning, and source of the value |",
                "|---|---|---|",
            ]
            for names, text in list_constants(file):
                values = ", ".join(write_value(name, getattr(module, name)) for name in names)
                lines.append(f"| {', '.join(f'`{name}`' for name in names)} | {values} | {text} |")
            lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(make_page(), encoding="utf-8")
