"""Record poses by hand: a person presses the object onto each gel in turn; no arm, no gripper."""

from dataclasses import dataclass
from typing import Protocol

from drivers.bench import Bench, Fingertip
from drivers.types import Pose
from protocols.observer import LiftEvents
from protocols.operator import Operator
from protocols.pump import Pump
from protocols.record_grasps import record_reference

CAPTURE_TIMEOUT_S = 20.0
"""Time for one question in which all its images must show contact."""


class HandObserver(LiftEvents, Protocol):
    """An observer that captures images of one fingertip on request."""

    def want_of(self, serial: str, images: int) -> None:
        """Capture this many more images of a fingertip that show contact."""
        ...

    def satisfied(self) -> bool:
        """Whether all requested images have been captured."""
        ...


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

    def question(self, tip: Fingertip) -> str:
        """Return the request to the person at a fingertip."""
        return (
            f"Press object {self.object_id} ({self.object_name}) at '{self.position}', turned by "
            f"{tip.sign * self.orientation_deg:+.0f} deg (counter-clockwise in the image), onto the gel of "
            f"{tip.sensor.serial} and hold it. Is it pressed?"
        )


def record_untouched(bench: Bench, operator: Operator, observer: LiftEvents) -> None:
    """Deliver frames of the gels without contact, after the person confirms that nothing touches them."""
    operator.look("Take everything off the gels. Does nothing touch them?")
    record_reference(bench, observer)


def record_pose_by_hand(bench: Bench, operator: Operator, pose: HandPose, observer: HandObserver) -> None:
    """Ask the person to press the object onto one gel after the other, and capture images; nothing is moved.

    Raises `OperatorStopError` if the person declines, `DeviceTimeoutError` if no image shows contact.
    """
    for number, tip in enumerate(bench.fingertips):
        share, rest = divmod(pose.images, len(bench.fingertips))
        operator.hold(pose.question(tip), pose.object_id, pose.base_T_grasp, pose.opening_m)
        pump = Pump(bench, observer)
        pump.start()
        observer.want_of(tip.sensor.serial, share + (number < rest))
        pump.run_until(observer.satisfied, CAPTURE_TIMEOUT_S)
