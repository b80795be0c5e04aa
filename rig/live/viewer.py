"""The process of a viewer: `python -m rig.live.viewer rerun|foxglove ADDRESS [ARGUMENT...]`.

It prints "ready" when it listens, and ends when its standard input ends. This also happens if the process
that started it is killed; a file is then complete up to that time.
"""

import os
import sys
import threading
from importlib import import_module
from typing import Protocol

from drivers.children import leave_signals_to_parent
from rig.live.feed import Inbox, Message

EVERY_S = 0.05
GIVE_WAY = 10
"""Niceness of the viewer relative to the lifts (nice(2))."""


class Scene(Protocol):
    """A view of lifts, opened by `open_scene` of `rig.live.rerun` or `rig.live.foxglove`."""

    def show(self, message: Message) -> None:
        """Show a message."""

    def close(self) -> None:
        """Write the remaining data."""


def main(arguments: list[str]) -> None:
    """Show messages until the input ends. arguments: viewer, address, and those of its `open_scene`."""
    # Ctrl-C is for the trial only; messages that the trial sends after it are still shown.
    leave_signals_to_parent()
    os.nice(GIVE_WAY)
    scene: Scene = import_module(f"rig.live.{arguments[0]}").open_scene(arguments[2:])
    inbox = Inbox(arguments[1])
    over = threading.Event()
    threading.Thread(target=_wait_for_end, args=(over,), daemon=True).start()
    print("ready", flush=True)
    while not over.wait(EVERY_S):
        _show(inbox, scene)
    _show(inbox, scene)
    inbox.close()
    scene.close()


def _show(inbox: Inbox, scene: Scene) -> None:
    for message in inbox.take():
        scene.show(message)


def _wait_for_end(over: threading.Event) -> None:
    sys.stdin.read()
    over.set()


if __name__ == "__main__":
    main(sys.argv[1:])
