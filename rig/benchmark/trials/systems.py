"""The systems of `rig benchmark trials` that look at a lift as a whole, not through a network's mask."""

from collections.abc import Mapping
from pathlib import Path

from drivers.types import Image
from rig.config.models import TactileConfig
from rig.tactile.estimators import ANGLENET, DEFAULT_ESTIMATOR, KOLAMURI, TOSKOV, choose_estimator
from rig.tactile.paper.axis import METHODS
from rig.tactile.peers.learned import AngleNetEstimator, ToskovEstimator
from rig.tactile.peers.networks import load_image_network, load_wrench_network
from rig.tactile.sample import SlipSample, State, TactileEstimator

ANGLENET_ON_TEST = "anglenet-on-test"
"""AngleNet as the paper trained it: on the lifts that it is then tested with."""
STILL = "still"
"""Says 0 all the time: what a system has to be better than."""
PLAIN = (DEFAULT_ESTIMATOR, *METHODS, ANGLENET, TOSKOV, STILL)
"""Systems that run on the lifts of the plain gel, beside the networks."""
PEER_FILES = (ANGLENET, ANGLENET_ON_TEST, TOSKOV)
"""Systems whose network may be given as a file."""
TITLES = {
    **{method: f"{method}, classical mask" for method in METHODS},
    KOLAMURI: "Kolamuri et al. (markers)",
    ANGLENET: "AngleNet, objects held back",
    ANGLENET_ON_TEST: "AngleNet, trained on these lifts",
    TOSKOV: "Toskov et al. (wrist), objects held back",
    STILL: "none: 0 all the time",
}


def title(system: str) -> str:
    """Return what tables call a system."""
    return TITLES.get(system, system)


def make_system(
    name: str, files: Mapping[str, Path], background: Image, tip: TactileConfig
) -> TactileEstimator:
    """Make a system for one fingertip, without a window. files: of `PEER_FILES`, where not shipped."""
    if name == STILL:
        return _Still()
    if name in (ANGLENET, ANGLENET_ON_TEST):
        return AngleNetEstimator(background, load_image_network(files.get(name)))
    if name == TOSKOV:
        return ToskovEstimator(background, tip.sign, load_wrench_network(files.get(name)))
    return choose_estimator(name, 1).make(background, tip.pixel_aspect, tip.sign)


class _Still(TactileEstimator):
    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Say 0."""
        return SlipSample(time_ns, State.TRACKING, 0.0)
