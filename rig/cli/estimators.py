"""`rig estimators`: what can be given as `--estimator`."""

from typing import Any

from rig.cli.common import JsonOption, emit_json


def estimators(json: JsonOption = False) -> None:
    """List the estimators that are here: the rig's own, and those that installed packages offer.

    Nothing is imported: a package says in its own metadata what it offers, as entry points of the group
    slip_rig.estimators. A class that is in no list is named in full, as package.module:Class.

    Examples:
      rig estimators

      rig estimators --json

    """
    from drivers.named_classes import installed_classes
    from rig.cli.fitting import table_console
    from rig.cli.printing import console_table
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
    from rig.tactile.foreign import GROUP

    found: list[dict[str, Any]] = [{"name": name, "from": "the rig", "class": None} for name in ESTIMATORS]
    for of in installed_classes(GROUP):
        hidden = of.name in ESTIMATORS
        found.append({"name": of.target if hidden else of.name, "from": of.distribution, "class": of.target})
    if json:
        emit_json({"default": DEFAULT_ESTIMATOR, "estimators": found})
        return
    rows = [(str(of["name"]), str(of["from"]), str(of["class"] or "")) for of in found]
    table_console().print(console_table(("--estimator", "from", "class"), rows, 3))
