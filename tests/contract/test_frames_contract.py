"""The rig's sensors and cameras, held to the checks of every source of frames."""

from rig.contract_checks.test_frames import *  # noqa: F403
