"""A template of a lab's own classes: keep those that you need, and replace what they simulate.

The rig calls a device's constructor with keys of the bench file: the parameters below, others of the table in
docs/extending.md if you add them, and each of `options`. It checks the file's workspace, speeds, ranges and
keep-out boxes before a motion reaches your class. Raise `drivers.errors.DeviceError` for failures.
"""

import math
from collections.abc import Callable

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import GripperFaultError, NotConnectedError
from drivers.interfaces import Arm, Gripper, TactileSensor
from drivers.motion import Motion
from drivers.types import ArmLimits, ArmMode, ArmState, GripperSpec, GripperState, Image, Pose, Vector3
from drivers.video.reader import FrameReader
from drivers.video.stream import FrameStream, RawFrame, decode_frame
from rig.tactile.sample import SlipSample, State, TactileEstimator

CHANGED_GREY, LEAST_PX = 12, 60
ROUND = 0.15
"""Below this difference of the axes, as a fraction of their sum, the contact has no long axis."""
SPEED_M_S = 0.07
"""Speed of the fingers if none is commanded."""


class MyLabEstimator(TactileEstimator):
    """Created with a frame without contact, (H, W, 3) uint8 RGB; then called once per frame, in order."""

    def __init__(self, background: Image) -> None:
        self._background = background
        self._last_deg: float | None = None

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Return the image angle of the changed area, counter-clockwise, unwrapped beyond 180 degrees."""
        change = cv2.absdiff(image, self._background).max(axis=2)
        mask = (cv2.medianBlur(change, 5) > CHANGED_GREY).astype(np.uint8)
        found = cv2.moments(mask, binaryImage=True)
        area_px = found["m00"]
        if area_px < LEAST_PX:
            return SlipSample(time_ns, State.NO_CONTACT)
        wide, high, both = found["mu20"], found["mu02"], 2 * found["mu11"]
        if math.hypot(wide - high, both) < ROUND * (wide + high):
            return SlipSample(time_ns, State.UNOBSERVABLE, contact_area_px=area_px)
        # y points down in an image, so the sign is inverted
        angle_deg = -math.degrees(0.5 * math.atan2(both, wide - high))
        if self._last_deg is not None:  # an axis is known modulo 180 degrees: take the nearest to the last
            angle_deg += 180.0 * round((self._last_deg - angle_deg) / 180.0)
        self._last_deg = angle_deg
        return SlipSample(time_ns, State.TRACKING, angle_deg, contact_area_px=area_px)


class MyLabStream(FrameStream):
    """The opened camera; one thread reads it. It is reopened after each `DeviceError` raised here."""

    warm_up = 0  # images to discard while exposure settles
    stamp = "peer"  # source of the capture times: "kernel", or the device, "peer"
    ends = False

    def __init__(self, rate_hz: float, size_px: tuple[int, int], clock: Clock, grey: int) -> None:
        self._clock, self._period_ns, self._grey = clock, NS_PER_S / rate_hz, grey
        self._shape = (size_px[1], size_px[0], 3)
        self._start_ns, self._number = clock.now_ns(), 0

    def read(self) -> RawFrame:
        """Wait for the next image, (H, W, 3) uint8 RGB, or its JPEG bytes as `encoded`."""
        self._number += 1
        taken_ns = self._start_ns + round(self._number * self._period_ns)
        self._clock.sleep_until(taken_ns)
        noise = np.random.default_rng(self._number).integers(-3, 4, self._shape)
        image = (self._grey + noise).astype(np.uint8)
        return RawFrame(self._clock.now_ns(), image=image, stamped_ns=taken_ns, number=self._number)

    def interrupt(self) -> None:
        """End a `read` in progress, if possible."""

    def close(self) -> None:
        """Close the device."""


class MyLabSensor(FrameReader, TactileSensor):
    """A tactile sensor; the external camera is the same without `set_light`."""

    def __init__(
        self, serial: str, rate_hz: float, size_px: tuple[int, int], clock: Clock, grey: int = 120
    ) -> None:
        def open_stream() -> FrameStream:
            return MyLabStream(rate_hz, size_px, clock, grey)

        super().__init__(
            serial, rate_hz, open_stream, lambda raw: decode_frame(raw, size_px, upright=False), clock
        )

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1, if your sensor has LEDs."""


class Travel:
    """The simulated motion of arm and fingers: from a value to another at a speed, m and m/s."""

    def __init__(self, clock: Clock, at: tuple[float, ...]) -> None:
        self._clock = clock
        self.stop_at(at)

    def stop_at(self, at: tuple[float, ...]) -> None:
        """Stay at a value."""
        self._from = self._to = at
        self._began_ns = self._ends_ns = self._clock.now_ns()

    def begin(self, to: tuple[float, ...], speed: float) -> None:
        """Begin to move."""
        self.stop_at(self.now())
        self._to, self._ends_ns = to, self._began_ns + to_ns(math.dist(self._from, to) / speed)

    def moving(self) -> bool:
        """Whether the motion has not ended."""
        return self._clock.now_ns() < self._ends_ns

    def now(self) -> tuple[float, ...]:
        """Return the present value."""
        gone = (self._clock.now_ns() - self._began_ns) / max(self._ends_ns - self._began_ns, 1)
        share = min(max(gone, 0.0), 1.0) if self._ends_ns > self._began_ns else 1.0
        return tuple(a + share * (b - a) for a, b in zip(self._from, self._to, strict=True))


class MyLabArm(Arm):
    """An arm without a force sensor. Check joint limits here: add the parameter `joint_limits_rad`."""

    def __init__(
        self,
        limits: ArmLimits,
        flange_T_tcp: Pose,  # noqa: N803 - frame names keep their case
        payload_kg: float,
        payload_cog_m: Vector3,
        clock: Clock,
    ) -> None:
        self._clock, self._connected = clock, False  # the bench checks `limits`
        self._travel, self._turned = Travel(clock, (0.45, 0.0, 0.30)), (1.0, 0.0, 0.0, 0.0)

    def connect(self) -> None:
        """Connect to the arm; nothing moves. Set TCP and payload here, if your controller has them."""
        self._connected = True

    def disconnect(self) -> None:
        """Stop, and close the connection."""
        if self._connected:
            self.stop()
        self._connected = False

    def state(self) -> ArmState:
        """Return the newest state: pose of the tool in the base, joints in rad, wrench in N and N m.

        A wrench of None: no force sensor, and the bench file must state that. Never return zeros instead.
        """
        if not self._connected:
            raise NotConnectedError("arm: used before connect; connect the bench first")
        x, y, z = self._travel.now()
        pose, joints = Pose((x, y, z), self._turned), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return ArmState(self._clock.now_ns(), pose, joints, None, ArmMode.RUNNING)

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        """Start a straight motion and return immediately."""
        self._travel.begin(base_T_tcp.position_m, speed_m_s)
        self._turned = base_T_tcp.quaternion_xyzw
        return Motion("arm", self._clock, lambda: not self._travel.moving(), self.stop)

    def stop(self) -> None:
        """Stop as fast as the arm can. Callable from any thread at any time; raises no error."""
        self._travel.stop_at(self._travel.now())

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop after `confirm(question)` returns; nothing moves. Here: never stopped."""


class MyLabGripper(Gripper):
    """A parallel gripper. Openings between the fingertips are in m, speeds in m/s, forces in N."""

    def __init__(self, spec: GripperSpec, clock: Clock) -> None:
        self._clock = clock
        self._connected = self._activated = False
        self._travel = Travel(clock, (spec.open_m,))

    def connect(self) -> None:
        """Connect to the gripper; nothing moves, and nothing is activated."""
        self._connected = True

    def disconnect(self) -> None:
        """Close the connection; the fingers stay as they are."""
        self._connected = False

    def activate(self) -> None:
        """Run the activation sequence; the rig has asked a person before."""
        self._activated = True

    def state(self) -> GripperState:
        """Return the newest state. Add `gripping` and `obstructed` if your gripper detects objects."""
        if not self._connected:
            raise NotConnectedError("gripper: used before connect; connect the bench first")
        (opening_m,) = self._travel.now()
        return GripperState(self._clock.now_ns(), self._activated, self._travel.moving(), opening_m)

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        """Start moving the fingers and return immediately. Use default speed and force if they are None."""
        if not self.state().activated:
            raise GripperFaultError("gripper: not activated; the next trial asks for it", 5)
        self._travel.begin((opening_m,), speed_m_s or SPEED_M_S)
        return Motion("gripper", self._clock, lambda: not self._travel.moving(), self.stop)

    def stop(self) -> None:
        """Hold the fingers where they are."""
        self._travel.stop_at(self._travel.now())
