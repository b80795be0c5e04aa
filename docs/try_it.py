"""Run the `rig` lines of each page in an empty folder: `python docs/try_it.py --out tried`."""

import argparse
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
AT_MOST_S, LONG_AT_MOST_S = 300.0, 7200.0
ALLOWED = {"rig benchmark": (0, 4), "rig calibrate": (0,)}
"""Exit codes that count as done; 4 is a missed limit."""
FIRST = "rig trial --object wrench --lifts 1 --out lift"
"""The session from which the reader's own frames, clip, background and session are made."""
_INDENTED = re.compile(r"^ {4}rig .*$", re.MULTILINE)
_FENCE = re.compile(r"^```sh$(.*?)^```$", re.DOTALL | re.MULTILINE)
NEEDS = {
    r"--bench (my_bench|desk)\.toml": "needs hardware",
    r"^rig live (?!.*--seconds)|^rig show": "needs a person who ends it",
    r"HOST:PORT": "needs a cluster",
    r"\bD20641\b": "needs a sensor",
    r"^rig label-angle|^rig label ": "needs a person who draws",
    r"^rig model import|authors\.onnx|--data|old/|--model \w+=": "needs files of yours",
    r"my_lab|my_bag|shared_objects|monday|/data/": "needs files of yours",
    r"^rig train": "needs the extra train",
    r"PRESSES|my_twin": "needs photographs of a pressed ball",
    "benchmark clips": "needs labels drawn by hand",
    "TactileTracking": "needs a public set",
    r"^rig trial --resume(?! --out)": "needs an unfinished session",
}
LONG = r"rig benchmark|rig trial --lifts 5|--full|--all"
OWN = {"FRAMES": "frames", "frames": "frames", "empty.png": "empty.png", "CLIPS": "clips", "clips": "clips",
       "CLIP": "clips/pen_2", "SESSIONS...": "sessions", "sessions": "sessions",
       "SESSION": "sessions/campaign"}  # fmt: skip
"""Names of the reader's own files on the pages, and the stand-ins for them."""


@dataclass(frozen=True)
class Line:
    """A command line of a page. text: the command; skipped if there is a reason."""

    page: str
    text: str
    why_not: str = ""


def command_lines(long: bool) -> list[Line]:
    """Return the lines of all pages, each once a page, in the order of the index."""
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    pages = [ROOT / "docs" / f"{name}.md" for name in re.findall(r"\]\((\w+)\.md\)", index)]
    return [
        Line(page.name, text, reason(text, long))
        for page in pages
        for text in dict.fromkeys(typed_lines(page.read_text(encoding="utf-8")))
    ]


def typed_lines(page: str) -> list[str]:
    """Return the lines of a page that begin with `rig`, in blocks of code; comments and pipes are cut off."""
    blocks = [*_FENCE.findall(page), *_INDENTED.findall(_FENCE.sub("", page))]
    lines = [line for block in blocks for line in re.sub(r"\\\n\s*", "", block).splitlines()]
    cut = [re.sub(r"\s+(?:\||>|&&|#)\s.*", "", line).strip() for line in lines]
    return [line for line in cut if line.startswith("rig ")]


def reason(text: str, long: bool) -> str:
    """Return why a line is not run; empty if it is run."""
    for pattern, why in NEEDS.items():
        if re.search(pattern, text):
            return why
    return "takes many minutes; --long runs it" if re.search(LONG, text) and not long else ""


def make_own_files(folder: Path) -> str:
    """Make what a reader would bring: frames, a background, a clip, a session; return what went wrong."""
    from drivers.images import encode_png
    from rig.frames.of_session import session_frames

    folder.mkdir()
    with ExitStack() as ending:
        wrong = run(Line("", FIRST), folder, folder, AT_MOST_S, ending)
    if wrong:
        return wrong
    tip = session_frames(folder / "lift")[0][0]
    clip = folder / "clips" / "pen_2"
    for frames in (folder / "frames", clip / "frames"):
        frames.mkdir(parents=True)
        for number, frame in enumerate(tip.frames):
            if frame.image is not None:
                (frames / f"{number:04d}.png").write_bytes(encode_png(frame.image))
    for place in (folder / "empty.png", clip / "background.png"):
        place.write_bytes(encode_png(tip.background))
    shutil.copytree(folder / "lift", folder / "sessions" / "campaign")
    return ""


def typed(line: Line, folder: Path, own: Path) -> list[str]:
    """Return the words behind `rig` as printed, but for names of a reader's own files, which lie in `own`."""
    command, *rest = shlex.split(line.text)[1:]
    words = [command]
    for word in rest:
        name, _, inside = word.partition("/")
        if name in OWN:
            words.append(str(own.absolute() / OWN[name] / inside))
        else:
            words += sorted(str(p.relative_to(folder)) for p in folder.glob(word)) if "*" in word else [word]
    return words


def serve(line: Line, folder: Path, own: Path, at_most_s: float, ending: ExitStack) -> str:
    """Start what serves until the page's end, as in another terminal; return what went wrong."""
    words, nowhere = typed(line, folder, own), subprocess.DEVNULL
    command = [sys.executable, "-m", "rig", *words]
    process = subprocess.Popen(command, cwd=folder, stdout=nowhere, stderr=nowhere)  # noqa: S603 - as below
    ending.callback(process.wait, 30)
    ending.callback(process.send_signal, signal.SIGINT)
    until = time.monotonic() + at_most_s
    while not (folder / words[words.index("--write") + 1]).exists():
        if process.poll() is not None or time.monotonic() > until:
            return "it does not serve"
        time.sleep(0.2)
    return ""


def run(line: Line, folder: Path, own: Path, at_most_s: float, ending: ExitStack) -> str:
    """Run a line in a folder; return an empty text, or what went wrong. ending: what ends with the page."""
    if line.text.startswith("rig fakes serve"):
        return serve(line, folder, own, at_most_s, ending)
    command = [sys.executable, "-m", "rig", *typed(line, folder, own)]
    quiet = {"capture_output": True, "text": True, "stdin": subprocess.DEVNULL}
    try:
        done = subprocess.run(command, cwd=folder, timeout=at_most_s, **quiet)  # noqa: S603 - our own pages'
    except subprocess.TimeoutExpired:
        return f"did not end within {at_most_s:.0f} s"
    allowed = next((codes for begin, codes in ALLOWED.items() if line.text.startswith(begin)), (0,))
    last = (done.stderr.strip() or "?").splitlines()[-1]
    return "" if done.returncode in allowed else f"exit {done.returncode}: {last}"


def main() -> int:
    """Run all lines; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Folder to work in; it must not exist.")
    parser.add_argument("--long", action="store_true", help="Also those that take many minutes.")
    parser.add_argument("--page", action="append", help="Page to try, such as desk; repeat for several.")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True)
    own = asked.out / "own_files"
    wrong = make_own_files(own)
    if wrong:
        print(f"the first lift fails, and the pages need its frames: {wrong}")
        return 1
    failed = 0
    for page, lines in groupby(command_lines(asked.long), lambda line: line.page):
        if asked.page and Path(page).stem not in asked.page:
            continue
        folder = asked.out / Path(page).stem
        folder.mkdir()
        failed += try_page(list(lines), folder, own, LONG_AT_MOST_S if asked.long else AT_MOST_S)
    print(f"{failed} failed")
    return 1 if failed else 0


def try_page(lines: list[Line], folder: Path, own: Path, at_most_s: float) -> int:
    """Run the lines of a page in an empty folder; print each result and return how many failed."""
    failed = 0
    with ExitStack() as ending:
        for line in lines:
            began, became = time.monotonic(), f"skipped: {line.why_not}"
            if not line.why_not:
                wrong = run(line, folder, own, at_most_s, ending)
                failed += bool(wrong)
                became = f"FAILED: {wrong}" if wrong else "done"
            print(
                f"{time.monotonic() - began:6.1f} s  {line.page}: {line.text}\n          {became}", flush=True
            )
    return failed


if __name__ == "__main__":
    sys.exit(main())
