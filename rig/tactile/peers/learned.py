"""The network methods that the paper compares with: AngleNet (one image) and Toskov et al. (wrist wrench).

Both detect the contact by image processing, as the other estimators do, because a lift has to detect when the
fingers touch. The networks are in ONNX files: one takes an image, the other equal time steps of the wrench,
relative to rest.
"""

from importlib.resources import as_file
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.errors import InputError
from drivers.types import ArmState, Image
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.model_files import MODELS, open_model, run_model
from rig.tactile.contact.network import frame_planes
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, Stopwatch

PERIOD_S = 1.0 / 30.0
"""Duration of a step; states within a step are averaged."""
REST_S = 0.5
"""Time from the start of a grasp over which the wrench at rest, without the object, is averaged."""

Wrench = NDArray[np.float32]


class WrenchSteps:
    """Converts the arm's states from the grasp on to steps of (6,) float32, relative to the wrench at rest.

    A step is the force in N and the torque in N m, at the TCP in the base's axes. States that are not newer
    than the previous one, or have no wrench, are skipped.
    """

    def __init__(self) -> None:
        self._gathered: list[tuple[float, ...]] = []
        self._resting: list[tuple[float, ...]] = []
        self._began_ns: int | None = None
        self._newest_ns = self._due_ns = 0
        self._rest: NDArray[np.float64] | None = None

    def add(self, state: ArmState) -> Wrench | None:
        """Process a state; return the step that it completes, or None if it completes none."""
        if state.wrench is None or (self._began_ns is not None and state.time_ns <= self._newest_ns):
            return None
        self._newest_ns = state.time_ns
        if self._began_ns is None:
            self._began_ns = state.time_ns
        if self._rest is None:
            self._resting.append(state.wrench)
            if state.time_ns - self._began_ns >= to_ns(REST_S):
                self._rest, self._due_ns = np.mean(self._resting, 0), state.time_ns
            return None
        self._gathered.append(state.wrench)
        # A step is complete half a period early, so that the state nearest to its end completes it.
        if state.time_ns < self._due_ns + to_ns(0.5 * PERIOD_S):
            return None
        self._due_ns = max(self._due_ns + to_ns(PERIOD_S), state.time_ns)
        step = np.mean(self._gathered, 0) - self._rest
        self._gathered.clear()
        return step.astype(np.float32)


Memory = NDArray[np.float32]

_HOW = "python tools/train_angle.py"
_LARGEST = 4096
"""Largest side of the memory, and of a network's image in px."""


class ImageAngleNetwork:
    """A network that estimates an angle from one tactile frame. size: (width, height) of its input in px."""

    def __init__(self, session: onnxruntime.InferenceSession, name: str) -> None:
        entries, answers = session.get_inputs(), session.get_outputs()
        if not entries or not answers:
            raise InputError(f"{name}: has no input or no output: make it with {_HOW} anglenet")
        shape = list(entries[0].shape)
        sides = all(isinstance(side, int) and 0 < side <= _LARGEST for side in shape[2:])
        fits = len(shape) == 4 and shape[:2] == [1, 3] and sides
        if len(entries) != 1 or not fits or list(answers[0].shape) != [1]:
            raise InputError(
                f"{name}: maps {[list(e.shape) for e in entries]} to {list(answers[0].shape)}, but a network "
                f"for an angle from a frame maps (1, 3, h, w) to (1): make one with {_HOW} anglenet"
            )
        self._session, self._name, self._key = session, name, entries[0].name
        self.size = (int(shape[3]), int(shape[2]))

    def angle_deg(self, image: Image) -> float:
        """Return the image angle, deg, of the object in an (H, W, 3) uint8 RGB frame."""
        planes = frame_planes(image, self.size)[None]
        return float(run_model(self._session, self._name, {self._key: planes})[0].reshape(-1)[0])


class WrenchAngleNetwork:
    """A recurrent network that estimates an angle from wrenches; the caller keeps its memory."""

    def __init__(self, session: onnxruntime.InferenceSession, name: str) -> None:
        shapes = {entry.name: list(entry.shape) for entry in session.get_inputs()}
        sized = all(isinstance(side, int) and 0 < side <= _LARGEST for side in shapes.get("memory", [None]))
        if set(shapes) != {"wrench", "memory"} or shapes["wrench"] != [1, 1, 6] or not sized:
            raise InputError(
                f"{name}: has the inputs {shapes}, but a network for an angle from wrenches has the inputs "
                f"'wrench' (1, 1, 6) and 'memory': make one with {_HOW} toskov"
            )
        self._session, self._name = session, name
        self._shape = tuple(int(side) for side in shapes["memory"])

    def blank(self) -> Memory:
        """Return the memory before the first step."""
        return np.zeros(self._shape, np.float32)

    def step(self, wrench: Wrench, memory: Memory) -> tuple[float, Memory]:
        """Return the rotation of the object, deg, after a step (6,), and the new memory."""
        answers = run_model(self._session, self._name, {"wrench": wrench[None, None], "memory": memory})
        if len(answers) != 2 or answers[1].shape != self._shape or not answers[0].size:
            raise InputError(
                f"{self._name}: its outputs are not an angle and the memory: make one with {_HOW} toskov"
            )
        return float(answers[0].reshape(-1)[0]), answers[1]


def load_image_network(file: Path | None = None) -> ImageAngleNetwork:
    """Load the rig's AngleNet, or one from a file. Raises `InputError`."""
    session, name = _open_network("anglenet", file)
    return ImageAngleNetwork(session, name)


def load_wrench_network(file: Path | None = None) -> WrenchAngleNetwork:
    """Load the rig's network after Toskov et al., or one from a file. Raises `InputError`."""
    session, name = _open_network("toskov", file)
    return WrenchAngleNetwork(session, name)


def _open_network(shipped: str, file: Path | None) -> tuple[onnxruntime.InferenceSession, str]:
    if file is not None and not file.is_file():
        raise InputError(f"{file}: file not found: make it with {_HOW} {shipped} --out FOLDER")
    with as_file(MODELS / f"{shipped}.onnx") as path:
        return open_model(file or path, 1, f"{_HOW} {shipped}"), str(file or shipped)


class AngleNetEstimator(FreshFrameEstimator):
    """Estimates the angle from each image independently, with a small ConvNeXt (paper, section IV-D).

    States: `no_contact`, else `tracking`; it never refuses a frame with contact.
    """

    stages = ("contact", "network")

    def __init__(self, background: Image, network: ImageAngleNetwork | None = None) -> None:
        super().__init__(background.shape)
        self._finder = ContactFinder(background)
        self._network = network or load_image_network()

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        contact = self._finder.find(image)
        watch.lap("contact")
        if contact.mask is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=watch.stage_s, skipped=("network",))
        angle = self._network.angle_deg(image)
        watch.lap("network")
        return SlipSample(
            time_ns, State.TRACKING, angle, contact_area_px=contact.area_px, stage_s=watch.stage_s
        )


class ToskovEstimator(FreshFrameEstimator):
    """Estimates the object's rotation from the wrist's wrench, with a recurrent network (Toskov et al. 2022).

    Frames are used only to detect contact. The angle is that of the newest state of the arm. sign: of the
    fingertip, which converts the object's angle to an image angle. States: `no_contact`; `unobservable` until
    the wrench at rest is known; else `tracking`.
    """

    stages = ("contact", "network")

    def __init__(self, background: Image, sign: int = 1, network: WrenchAngleNetwork | None = None) -> None:
        super().__init__(background.shape)
        self._finder, self._sign = ContactFinder(background), sign
        self._network = network or load_wrench_network()
        self._steps, self._memory = WrenchSteps(), self._network.blank()
        self._angle_deg: float | None = None
        self._spent_s = 0.0

    def arm(self, state: ArmState) -> None:
        """Process the wrench in a state of the arm."""
        watch = Stopwatch()
        step = self._steps.add(state)
        if step is not None:
            self._angle_deg, self._memory = self._network.step(step, self._memory)
        watch.lap("network")
        self._spent_s += watch.stage_s["network"]

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        watch = Stopwatch()
        contact = self._finder.find(image)
        watch.lap("contact")
        stage_s, self._spent_s = {**watch.stage_s, "network": self._spent_s}, 0.0
        area = contact.area_px
        if contact.mask is None:
            return SlipSample(time_ns, State.NO_CONTACT, stage_s=stage_s)
        if self._angle_deg is None:
            return SlipSample(time_ns, State.UNOBSERVABLE, contact_area_px=area, stage_s=stage_s)
        angle = self._sign * self._angle_deg
        return SlipSample(time_ns, State.TRACKING, angle, contact_area_px=area, stage_s=stage_s)
