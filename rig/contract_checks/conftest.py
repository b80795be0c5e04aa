"""Reports the missing options if the checks are run without them."""

import pytest


def pytest_itemcollected(item: pytest.Item) -> None:
    """Stop a run that could check nothing."""
    if not item.config.pluginmanager.has_plugin("rig.contract_checks.options"):
        raise pytest.UsageError("add -p rig.contract_checks.options, and --estimator NAME or --bench FILE")
