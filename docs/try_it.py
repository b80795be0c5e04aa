"""Runs every `rig` line of the pages once: `python docs/try_it.py --out tried`. See `try_it.md`."""

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
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
AT_MOST_S, LONG_AT_MOST_S = 300.0, 7200.0
ALLOWED = {"rig benchmark": (0, 4), "rig calibrate": (0,)}
"""Exit codes that count as done; 4 is a missed limit."""
FIRST = "rig trial --object wrench --lifts 1 --out first"
"""The session from which frames, a clip and a background are taken."""
_INDENTED = re.compile(r"^ {4}rig .*$", re.MULTILINE)
_FENCE = re.compile(r"^```sh$(.*?)^```$", re.DOTALL | re.MULTILINE)
NEEDS = {
    r"^rig (?!objects).*--bench my_bench\.toml": "needs hardware",
    r"HOST:PORT": "needs a cluster",
    r"^rig label-angle|^rig label ": "needs somebody who draws",
    r"^rig model import|authors\.onnx|--data|old/|--model \w+=": "needs files of yours",
    r"my_lab|shared_objects|monday|/data/": "needs files of yours",
    r"^rig train": "needs the extra train",
    r"benchmark clips": "needs labels that somebody drew",
    r"benchmark others": "needs clones of others' repositories",
    r"^rig trial --resume(?! --out)": "needs an unfinished session",
}
LONG = r"rig benchmark|rig trial --lifts 5|--full|--all"
STANDS_FOR = {"FRAMES": "frames", "CLIPS": "clips", "SESSIONS...": "sessions",
              "SESSION": "first", "CLIP": "clips/pen_2"}  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A command line: where it stands, what is run, and why not."""

    page: str
    text: str
    why_not: str = ""


def command_lines(long: bool) -> list[Line]:
    """Return the lines of all pages, each once, in the order of the index."""
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    pages = [ROOT / "docs" / f"{name}.md" for name in re.findall(r"\]\((\w+)\.md\)", index)]
    found: dict[str, Line] = {}
    for page in pages:
        for text in typed_lines(page.read_text(encoding="utf-8")):
            found.setdefault(text, Line(page.name, text, reason(text, long)))
    # what is calibrated is used by all that comes after
    return sorted(found.values(), key=lambda line: line.page == "calibrating.md")


def typed_lines(page: str) -> list[str]:
    """Return the lines of a page that begin with `rig`, in blocks of code; comments and pipes are cut off."""
    blocks = [*_FENCE.findall(page), *_INDENTED.findall(_FENCE.sub("", page))]
    lines = [line for block in blocks for line in re.sub(r"\\\n\s*", "", block).splitlines()]
    cut = [re.sub(r"\s+(?:\||>|&&|#)\s.*", "", line).strip() for line in lines]
    return [line for line in cut if line.startswith("rig ")]


def reason(text: str, long: bool) -> str:
    """Say why a line is not run, or nothing."""
    for pattern, why in NEEDS.items():
        if re.search(pattern, text):
            return why
    return "takes many minutes; --long runs it" if re.search(LONG, text) and not long else ""


def bring_along(folder: Path) -> None:
    """Make what a person would bring: frames, a background, a clip, a bench file's neighbours."""
    from drivers.images import encode_png
    from rig.frames.of_session import session_frames

    tip = session_frames(folder / "first")[0][0]
    clip = folder / "clips" / "pen_2"
    for frames in (folder / "frames", clip / "frames"):
        frames.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(tip.frames):
            if frame.image is not None:
                (frames / f"{number:04d}.png").write_bytes(encode_png(frame.image))
    for place in (folder / "empty.png", clip / "background.png"):
        place.write_bytes(encode_png(tip.background))
    (folder / "objects").mkdir()
    shutil.copytree(folder / "first", folder / "sessions" / "campaign", dirs_exist_ok=True)


def typed(line: Line, folder: Path) -> list[str]:
    """Return the words behind `rig`, with what stands for a person's own."""
    text = line.text
    for name, instead in STANDS_FOR.items():
        text = re.sub(rf"(?<![\w-]){re.escape(name)}(?!\w)", instead, text)
    words: list[str] = []
    for word in shlex.split(text)[1:]:
        words += sorted(str(p.relative_to(folder)) for p in folder.glob(word)) if "*" in word else [word]
    return words


def serve(line: Line, folder: Path, at_most_s: float, ending: ExitStack) -> str:
    """Start what serves until the page's end, as in another terminal; return what went wrong."""
    words, nowhere = typed(line, folder), subprocess.DEVNULL
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


def run(line: Line, folder: Path, at_most_s: float, ending: ExitStack) -> str:
    """Run a line; return an empty text, or what went wrong. ending: what is to be done after the page."""
    if line.text.startswith("rig fakes serve"):
        return serve(line, folder, at_most_s, ending)
    command = [sys.executable, "-m", "rig", *typed(line, folder)]
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
    asked = parser.parse_args()
    asked.out.mkdir(parents=True)
    with ExitStack() as ending:
        failed = try_all(
            command_lines(asked.long), asked.out, ending, LONG_AT_MOST_S if asked.long else AT_MOST_S
        )
    print(f"{failed} failed")
    return 1 if failed else 0


def try_all(lines: list[Line], folder: Path, ending: ExitStack, at_most_s: float) -> int:
    """Run lines, one after the other, and say what became of each; return how many failed."""
    failed = 0
    for before, line in zip([None, *lines], lines, strict=False):
        if before is not None and before.page != line.page:
            ending.close()
        began, became = time.monotonic(), f"skipped: {line.why_not}"
        if not line.why_not:
            wrong = run(line, folder, at_most_s, ending)
            failed += bool(wrong)
            became = f"FAILED: {wrong}" if wrong else "done"
        print(f"{time.monotonic() - began:6.1f} s  {line.page}: {line.text}\n          {became}", flush=True)
        if line.text == FIRST:
            if failed:
                print("the other lines use this session: nothing more is run")
                return failed
            bring_along(folder)
    return failed


if __name__ == "__main__":
    sys.exit(main())
