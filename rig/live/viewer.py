"""The process of the viewer rerun: `python -m rig.live.viewer ADDRESS`.

It prints "ready" when it listens, and ends when its standard input ends, also if the process that
started it is killed.
"""

import os
import sys
import threading

from drivers.children import leave_signals_to_parent
from rig.live.feed import Inbox
from rig.live.rerun import RerunScene

EVERY_S = 0.05
GIVE_WAY = 10
"""Niceness of the viewer relative to the lifts (nice(2))."""


def main(address: str) -> None:
    """Show the messages that are sent to an address until the input ends."""
    # Ctrl-C is for the trial only; messages that the trial sends after it are still shown.
    leave_signals_to_parent()
    os.nice(GIVE_WAY)
    scene = RerunScene()
    inbox = Inbox(address)
    over = threading.Event()
    threading.Thread(target=_wait_for_end, args=(over,), daemon=True).start()
    print("ready", flush=True)
    while not over.wait(EVERY_S):
        _show(inbox, scene)
    _show(inbox, scene)
    inbox.close()
    scene.close()


def _show(inbox: Inbox, scene: RerunScene) -> None:
    for message in inbox.take():
        scene.show(message)


def _wait_for_end(over: threading.Event) -> None:
    sys.stdin.read()
    over.set()


if __name__ == "__main__":
    main(sys.argv[1])
