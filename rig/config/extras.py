"""Optional dependencies that only some commands need (extras of this package)."""

from importlib.util import find_spec

from drivers.errors import InputError


def require_extra(module: str, extra: str, needs: str) -> None:
    """Raise `InputError` with the installation command if a module of an extra is missing.

    needs: beginning of the message, such as "ROS bags need".
    """
    if find_spec(module) is None:
        raise InputError(f'{needs} {module}: pip install "visuotactile-slip-rig[{extra}]"')
