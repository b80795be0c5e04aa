"""Measure the host load with a process that only wakes every 10 ms.

`python waking.py PID` watches until its input ends, then prints a line of JSON. late_s: how late it woke
at worst. others_cores: how much of the cores went at worst, in a second, to processes that do not descend
from PID, and to the host of a virtual machine; 0 where there is no /proc.
"""

import contextlib
import json
import os
import select
import sys
import time
from pathlib import Path

PERIOD_S = 0.01
WINDOW_S = 1.0
MOST_OTHERS_CORES = 0.3
"""Load of other programs, in cores, up to which the host counts as free for real-time tests."""
SHORTEST_S = 0.3
"""Least length of a window: the kernel counts CPU time in steps of 10 ms."""


def watch(root: int) -> dict[str, float]:
    """Watch until the input ends."""
    late_s = others = 0.0
    due = began = time.monotonic()
    spent = others_s(root)
    while not select.select([sys.stdin], [], [], max(0.0, due + PERIOD_S - time.monotonic()))[0]:
        due += PERIOD_S
        now = time.monotonic()
        late_s, due = max(late_s, now - due), max(due, now)
        if now - began >= WINDOW_S:
            until = others_s(root)
            others = max(others, (until - spent) / (now - began))
            began, spent = now, until
    rest_s = time.monotonic() - began
    if rest_s >= SHORTEST_S:
        others = max(others, (others_s(root) - spent) / rest_s)
    return {"late_s": late_s, "others_cores": others}


def others_s(root: int) -> float:
    """CPU time so far, s, of all but the descendants of `root`."""
    processes = dict(_processes())
    if not processes:
        return 0.0
    words = Path("/proc/stat").read_text().split(maxsplit=11)
    used = sum(int(words[i]) for i in (1, 2, 3, 6, 7, 8))  # user, nice, system, irq, softirq, steal
    ours = sum(ticks for pid, (_, ticks) in processes.items() if _descends(pid, root, processes))
    return (used - ours) / os.sysconf("SC_CLK_TCK")


def _processes() -> list[tuple[int, tuple[int, int]]]:
    """Each process with its parent and its ticks, those of its ended children among them."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "stat").read_text().rpartition(")")[2].split()
            found.append((int(folder.name), (int(words[1]), sum(map(int, words[11:15])))))
    return found


def _descends(pid: int, root: int, processes: dict[int, tuple[int, int]]) -> bool:
    while pid not in (root, 0):
        pid = processes.get(pid, (0, 0))[0]
    return pid == root


if __name__ == "__main__":
    print(json.dumps(watch(int(sys.argv[1]))))
