"""The rig's arms, held to the checks of every arm."""

from rig.contract_checks.test_arm import *  # noqa: F403
