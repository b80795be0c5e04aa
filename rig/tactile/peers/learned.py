"""The network methods that the paper compares with: AngleNet (one image) and Toskov et al. (wrist wrench).

Both detect the contact by image processing, as the other estimators do, because a lift has to detect when the
fingers touch.
"""

from drivers.types import ArmState, Image
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.peers.networks import (
    ImageAngleNetwork,
    WrenchAngleNetwork,
    load_image_network,
    load_wrench_network,
)
from rig.tactile.peers.wrench_steps import WrenchSteps
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State
from rig.tactile.stopwatch import Stopwatch


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
