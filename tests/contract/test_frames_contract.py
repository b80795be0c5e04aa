"""Contract checks of the rig's sensors and cameras."""

from rig.contract_checks.test_frames import *  # noqa: F403
