"""What the hand of a bench is known to do, in files that outlive a program that is killed."""

import logging
import re
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.bench import Bench
from drivers.errors import DeviceError, FormatError, InvalidStateError, RecordingError
from drivers.formats import read_json
from drivers.images import encode_png, load_image
from drivers.interfaces import FrameSource
from drivers.types import HandState, Holding, Image, Pose
from rig.sessions.files import state_folder, write_file, write_json
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.touch import TOUCH_FRAMES

FRAME_S = 1.0
_log = logging.getLogger("rig.bench.hand")


class HandMemory:
    """Remembers the hand of one arm: what it does, and how its fingertips look untouched.

    arm: the address of the arm that the hand is on.
    """

    def __init__(self, arm: str) -> None:
        self._folder = state_folder() / "hands"
        self._name = _file_name(arm)

    def recall(self) -> HandState:
        """What was known last; unknown where nothing was kept, or not to be read.

        Raises `RecordingError` where nothing can be kept from now on.
        """
        state = self._read()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(
                f"{self._folder}: cannot be written ({error.strerror}): what the hand holds is kept there "
                "over crashes; set XDG_STATE_HOME to a folder that can be written"
            ) from error
        write_json(self._file, _packed(state))
        return state

    def keep(self, state: HandState) -> None:
        """Keep what is known now. What cannot be written is logged: the hand goes on with what it does."""
        try:
            write_json(self._file, _packed(state))
        except RecordingError as error:
            _log.warning("%s", error)

    def keep_untouched(self, bench: Bench) -> None:
        """Keep how the fingertips look now, untouched; without a picture where there is none."""
        for tip in bench.fingertips:
            with suppress(DeviceError, RecordingError):
                write_file(self._picture(tip.sensor), encode_png(tip.sensor.newest_frame(FRAME_S).image))

    def touched(self, bench: Bench) -> list[str]:
        """Serials of the fingertips that look touched, by what they looked like untouched."""
        return [tip.sensor.serial for tip in bench.fingertips if self._looks_touched(tip.sensor)]

    def _looks_touched(self, sensor: FrameSource) -> bool:
        before = load_image(self._picture(sensor))
        if before is None:
            return False
        finder = ContactFinder(before)
        try:
            return all(_shows_contact(finder, sensor.next_frame(FRAME_S).image) for _ in range(TOUCH_FRAMES))
        except DeviceError:  # whoever waits for its frames will say so
            return False

    def _read(self) -> HandState:
        try:
            return _unpacked(read_json(self._file))
        except (FormatError, InvalidStateError, ValueError, KeyError, TypeError, OverflowError):
            if not self._file.exists():
                return HandState(Holding.UNKNOWN, "no run has told yet")
            return HandState(Holding.UNKNOWN, f"{self._file} is damaged")

    @property
    def _file(self) -> Path:
        return self._folder / f"{self._name}.json"

    def _picture(self, sensor: FrameSource) -> Path:
        return self._folder / f"{self._name}-{_file_name(sensor.serial)}.png"


def _shows_contact(finder: ContactFinder, image: Image) -> bool:
    return finder.find(image).mask is not None


def _packed(state: HandState) -> dict[str, Any]:
    return {**asdict(state), "holding": state.holding.value}


def _unpacked(values: dict[str, Any]) -> HandState:
    place = values["base_T_grasp"]
    pose = None if place is None else Pose(tuple(place["position_m"]), tuple(place["quaternion_xyzw"]))
    counts, holding = values["finger_counts"], Holding(values["holding"])
    return HandState(holding, str(values["what"]), pose, float(values["width_m"]), counts)


def _file_name(text: str) -> str:
    return re.sub(r"[^\w.-]", "_", text)
