"""Contract checks of the rig's arms."""

from rig.contract_checks.test_arm import *  # noqa: F403
