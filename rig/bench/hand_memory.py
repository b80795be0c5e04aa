"""Store the state of a bench's hand in files that survive a killed program."""

import logging
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import quote

from drivers.bench import Bench
from drivers.errors import DeviceError, FormatError, InvalidStateError, RecordingError
from drivers.formats import read_json
from drivers.images import encode_png, load_image
from drivers.interfaces import FrameSource
from drivers.types import HandState, Holding, Pose
from rig.sessions.files import state_folder, write_file, write_json
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.gate import TOUCH_FRAMES

FRAME_S = 1.0
"""Largest age of a stored frame, and time limit for the next one."""
_log = logging.getLogger("rig.bench.hand")


class HandMemory:
    """Stores the state of one arm's hand, and the no-contact frames of its fingertips.

    arm: the address of the arm that the hand is on.
    """

    def __init__(self, arm: str) -> None:
        self._folder = state_folder() / "hands"
        self._name = quote(arm, safe="")
        self._file = self._folder / f"{self._name}.json"

    def recall(self) -> HandState:
        """Return the last stored state; unknown if none was stored, or it cannot be read.

        Raises `RecordingError` if the folder cannot be written.
        """
        state = self._read()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(
                f"{self._folder}: cannot be written ({error.strerror}): it stores what the hand holds "
                "across crashes; set XDG_STATE_HOME to a writable folder"
            ) from error
        write_json(self._file, {**asdict(state), "holding": state.holding.value})
        return state

    def keep(self, state: HandState) -> None:
        """Store the state. A failure is only logged, because the hand continues its motion."""
        try:
            write_json(self._file, {**asdict(state), "holding": state.holding.value})
        except RecordingError as error:
            _log.warning("%s", error)

    def keep_untouched(self, bench: Bench) -> None:
        """Store the current no-contact frame of each fingertip; skip fingertips without a frame."""
        for tip in bench.fingertips:
            with suppress(DeviceError, RecordingError):
                write_file(self._picture(tip.sensor), encode_png(tip.sensor.newest_frame(FRAME_S).image))

    def touched(self, bench: Bench) -> list[str]:
        """Return the serials of fingertips that show contact, compared with the stored no-contact frames."""
        return [tip.sensor.serial for tip in bench.fingertips if self._looks_touched(tip.sensor)]

    def _looks_touched(self, sensor: FrameSource) -> bool:
        before = load_image(self._picture(sensor))
        if before is None:
            return False
        finder = ContactFinder(before)
        try:
            frames = (sensor.next_frame(FRAME_S).image for _ in range(TOUCH_FRAMES))
            return all(finder.find(image).mask is not None for image in frames)
        except DeviceError:  # reported later, when the sensor's frames are needed
            return False

    def _read(self) -> HandState:
        try:
            return _unpacked(read_json(self._file))
        except (FormatError, InvalidStateError, ValueError, KeyError, TypeError, OverflowError):
            if not self._file.exists():
                return HandState(Holding.UNKNOWN, "no run has stored it yet")
            return HandState(Holding.UNKNOWN, f"{self._file} is damaged")

    def _picture(self, sensor: FrameSource) -> Path:
        return self._folder / f"{self._name}-{quote(sensor.serial, safe='')}.png"


def _unpacked(values: dict[str, Any]) -> HandState:
    place = values["base_T_grasp"]
    pose = None if place is None else Pose(tuple(place["position_m"]), tuple(place["quaternion_xyzw"]))
    return HandState(
        Holding(values["holding"]),
        str(values["what"]),
        pose,
        float(values["width_m"]),
        values["finger_opening_m"],
    )
