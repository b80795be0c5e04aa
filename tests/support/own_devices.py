"""A lab's own drivers, as a module in a separate folder."""

MODULE = "lab_devices"
OF_OUR_DRIVERS = {
    "arm": ("host", "frequency_hz"),
    "gripper": ("transport", "host", "port", "preset"),
    "camera": ("address",),
}
"""Keys of a real bench that these drivers and those of `rig new lab` do not accept."""
SOURCE = '''
"""Not the rig's."""
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from drivers.errors import DeviceTimeoutError
from drivers.interfaces import Arm, Camera, Gripper, TactileSensor
from drivers.robotiq_3f.gripper import Robotiq3F, tcp_link
from drivers.types import ArmMode, ArmState, Frame, GripperState, Pose
from drivers.ur5e.arm import UR5e
from drivers.video.digit import Digit
from drivers.video.external_camera import ExternalCamera

Path(__file__).with_name("imported").touch()


class Wrist(UR5e):
    """The rig's arm under another name."""


class Hand(Robotiq3F):
    """The rig's gripper, made in another way."""

    def __init__(self, host, port, spec, fingers, clock, registers="tcp"):
        super().__init__(tcp_link(host, port, registers), fingers, spec, clock)


class Finger(Digit):
    """The rig's sensor with an option."""

    def __init__(self, serial, rate_hz, size_px, address, clock, gel="soft"):
        super().__init__(serial, rate_hz, size_px, address=address, clock=clock)
        self.gel = gel


class Eye(ExternalCamera):
    """The rig's camera under another name."""


class Motion:
    def __init__(self, stuck=False):
        self.stuck = stuck

    def is_done(self):
        if self.stuck:
            raise KeyError("joint 3")
        return True


class Plain(Arm):
    """Moves instantly to each target, and records the commands."""

    def __init__(
        self, limits, flange_T_tcp, payload_kg, payload_cog_m, *, stuck=False, behaviour=None, ahead_s=0.0
    ):
        self.heard, self.stuck, self.behaviour, self.ahead_s = [], stuck, behaviour, ahead_s
        self.pose = Pose((0.45, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0))

    def connect(self):
        self.heard.append("connect")

    def disconnect(self):
        self.heard.append("disconnect")

    def state(self):
        if self.behaviour == "nothing":
            return None
        if self.behaviour == "unvalidated":
            return SimpleNamespace(time_ns=time.monotonic_ns(), wrench=(float("nan"),) * 6)
        x = float("nan") if self.behaviour == "nan" else 0.0
        wrench = None if self.behaviour == "no wrench" else (0.0,) * 6
        time_ns = time.monotonic_ns() + round(1e9 * self.ahead_s)
        return ArmState(time_ns, self.pose, (x, 0.0, 0.0, 0.0, 0.0, 0.0), wrench, ArmMode.RUNNING)

    def move_linear(self, base_T_tcp, speed_m_s, acceleration_m_s2):
        self.heard.append("move")
        self.pose = base_T_tcp
        return "moved" if self.behaviour == "no motion" else Motion(self.stuck)

    def stop(self):
        if self.stuck:
            raise OSError("line dead")

    def recover(self, confirm):
        confirm("Shall it go on?")


class Fingers(Gripper):
    def __init__(self, spec, *, at=0.12, ahead_s=0.0):
        self.at, self.ahead_s = at, ahead_s

    def connect(self):
        pass

    def disconnect(self):
        pass

    def activate(self):
        pass

    def state(self):
        time_ns = time.monotonic_ns() + round(1e9 * self.ahead_s)
        return GripperState(time_ns, True, False, self.at)

    def move_to(self, opening_m, speed_m_s=None, force_n=None):
        self.at = opening_m
        return Motion()

    def stop(self):
        pass


class Gel:
    """No base class: what it has counts."""

    def __init__(self, serial, rate_hz, *, behaviour="frames"):
        self.serial, self.behaviour = serial, behaviour

    def connect(self):
        pass

    def disconnect(self):
        pass

    def next_frame(self, timeout_s):
        image = np.zeros((320, 240, 3), np.uint8)
        frames = {
            "frames": Frame(image, 1, 1, self.serial),
            "another": Frame(image, 1, 1, "of another sensor"),
            "small": Frame(image[::2], 1, 1, self.serial),
            "float": Frame(image.astype(float), 1, 1, self.serial),
            "text": Frame(image, "now", 1, self.serial),
            "array": image,
        }
        if self.behaviour == "crash":
            raise ZeroDivisionError("rate")
        if self.behaviour == "late":
            raise DeviceTimeoutError("no frame came")
        return frames[self.behaviour]

    newest_frame = next_frame


class Pressed(Gel):
    """Shows a contact while the file `pressed` exists beside this module."""

    def __init__(self, serial, rate_hz, clock):
        self.serial, self.clock, self.count = serial, clock, 0

    def newest_frame(self, max_age_s):
        return self.next_frame(1.0)

    def next_frame(self, timeout_s):
        if timeout_s < 0.01:
            raise DeviceTimeoutError("not yet")
        time.sleep(0.01)
        self.count += 1
        image = np.random.default_rng(self.count).normal(100, 1.5, (320, 240, 3))
        if Path(__file__).with_name("pressed").exists():
            cv2.ellipse(image, (120, 160), (30, 70), 20, 0, 360, (180, 60, 120), -1)
        return Frame(image.clip(0, 255).astype(np.uint8), self.clock.now_ns(), self.count, self.serial)

    def set_light(self, red, green, blue):
        pass


class Half(Camera):
    """Leaves newest_frame to the Protocol, which has none."""

    def __init__(self, serial, rate_hz):
        pass

    def connect(self):
        pass

    def disconnect(self):
        pass

    def next_frame(self, timeout_s):
        pass


class Careless(Plain):
    """Takes no payload."""

    def __init__(self, limits, flange_T_tcp):
        pass
'''
