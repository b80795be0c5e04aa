"""Says what to type where the checks are run without their options."""

import pytest


def pytest_itemcollected(item: pytest.Item) -> None:
    """End a run that could check nothing."""
    if not item.config.pluginmanager.has_plugin("rig.contract_checks.options"):
        raise pytest.UsageError("add -p rig.contract_checks.options, and --estimator NAME or --bench FILE")
