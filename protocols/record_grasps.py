"""Record grasp poses (paper, section IV-A): first the reference, then each pose at several grips."""

from dataclasses import dataclass
from typing import Protocol

from drivers.bench import Bench
from drivers.types import Pose
from protocols.observer import LiftEvents, LiftObserver
from protocols.pump import Pump
from protocols.safe_end import safe_end
from protocols.steps import approach, close_to_contact, lower_and_release, step_fingers

REFERENCE_S = 0.5
"""Duration of the frames without contact before the fingers close."""
CAPTURE_TIMEOUT_S = 4.0
"""Time limit for capturing the images of one grip."""


class CaptureObserver(LiftObserver, Protocol):
    """An observer that captures images on request."""

    def want(self, images: int, grip_steps: int) -> None:
        """Capture this many more images, at a grip of `grip_steps` steps beyond first contact."""
        ...

    def satisfied(self) -> bool:
        """Whether all requested images have been captured."""
        ...


@dataclass(frozen=True, slots=True)
class PosePlan:
    """One grasp pose to record.

    grips: pairs of a grip, in steps of the gripper's resolution beyond first contact, and number of images.
    """

    object_id: str
    object_name: str
    pose_number: int
    base_T_grasp: Pose  # noqa: N815 - frame names keep their case
    width_m: float
    grips: tuple[tuple[int, int], ...]


def record_reference(bench: Bench, observer: LiftEvents) -> None:
    """Deliver frames of the fingertips without contact; nothing moves."""
    pump = Pump(bench, observer)
    pump.start()
    pump.run_for(REFERENCE_S)


def record_pose(bench: Bench, plan: PosePlan, observer: CaptureObserver) -> None:
    """Grasp at one pose, tighten step by step while images are captured, and release the object.

    Raises the device's error after the safe end, with a note on how it ended.
    """
    with safe_end(bench):
        pump = Pump(bench, observer)
        approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
        pump.start()
        contact_m = close_to_contact(bench, pump, observer)
        for grip_steps, images in plan.grips:
            step_fingers(bench, pump, observer, bench.gripper.spec.closer(contact_m, grip_steps))
            observer.want(images, grip_steps)
            pump.run_until(observer.satisfied, CAPTURE_TIMEOUT_S)
        lower_and_release(bench, plan.base_T_grasp, plan.width_m, pump)
