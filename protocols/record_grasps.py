"""Record grasp poses (paper, section IV-A): first the reference, then each pose at several grips.

Also by hand: a person presses the object onto each gel in turn; no arm and no gripper are needed.
"""

from dataclasses import dataclass
from typing import Protocol

from drivers.bench import Bench
from drivers.types import Pose
from protocols.observer import LiftEvents, LiftObserver
from protocols.operator import Operator
from protocols.pump import Pump
from protocols.safe_end import safe_end
from protocols.steps import approach, close_to_contact, lower_and_release, step_fingers

REFERENCE_S = 0.5
"""Duration of the frames without contact before the fingers close."""
CAPTURE_TIMEOUT_S = 4.0
"""Time limit for capturing the images of one grip."""


class CaptureObserver(LiftObserver, Protocol):
    """An observer that captures images that show contact, on request."""

    def want(self, images: int, grip_steps: int | None = None, serial: str | None = None) -> None:
        """Capture this many more images. grip_steps: steps beyond first contact, None if pressed by hand.

        serial: of the only fingertip that is pressed; None for all.
        """

    def is_complete(self) -> bool:
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
            missed = f"{images} images with contact were not captured"
            pump.run_until(observer.is_complete, CAPTURE_TIMEOUT_S, missed)
        lower_and_release(bench, plan.base_T_grasp, plan.width_m, pump)


HAND_TIMEOUT_S = 20.0
"""Time for one question in which all its images must show contact."""


@dataclass(frozen=True, slots=True)
class HandPose:
    """One pose to record by hand.

    orientation_deg: of the object, counter-clockwise in the images of a fingertip with sign +1. images:
    number over all fingertips. base_T_grasp, opening_m: where a robot hand would hold it; for a simulated
    person.
    """

    object_id: str
    object_name: str
    position: str
    orientation_deg: float
    images: int
    base_T_grasp: Pose  # noqa: N815 - frame names keep their case
    opening_m: float


def record_untouched(bench: Bench, operator: Operator, observer: LiftEvents) -> None:
    """Deliver frames of the gels without contact, after the person confirms that nothing touches them."""
    operator.look("Take everything off the gels. Does nothing touch them?")
    record_reference(bench, observer)


def record_pose_by_hand(bench: Bench, operator: Operator, pose: HandPose, observer: CaptureObserver) -> None:
    """Ask the person to press the object onto one gel after the other, and capture images; nothing is moved.

    Raises `OperatorStopError` if the person declines, `DeviceTimeoutError` if no image shows contact.
    """
    for number, tip in enumerate(bench.fingertips):
        share, rest = divmod(pose.images, len(bench.fingertips))
        question = (
            f"Press object {pose.object_id} ({pose.object_name}) at '{pose.position}', turned by "
            f"{tip.sign * pose.orientation_deg:+.0f} deg (counter-clockwise in the image), onto the gel of "
            f"{tip.sensor.serial} and hold it. Is it pressed?"
        )
        operator.hold(question, pose.object_id, pose.base_T_grasp, pose.opening_m)
        pump = Pump(bench, observer)
        pump.start()
        observer.want(share + (number < rest), serial=tip.sensor.serial)
        missed = f"the images of {tip.sensor.serial} with contact were not captured"
        pump.run_until(observer.is_complete, HAND_TIMEOUT_S, missed)
