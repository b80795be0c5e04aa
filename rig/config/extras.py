"""Optional dependencies that only some commands need (extras of this package)."""

from importlib.util import find_spec

from drivers.errors import InputError

WIRE = {"pymodbus": "bench", "serial": "bench", "rtde_control": "bench", "rtde_receive": "bench"}
"""Extras by the modules that simulated devices import when their code is loaded."""


def require_extra(module: str, extra: str, needs: str) -> None:
    """Raise `InputError` with the installation command if a module of an extra is missing.

    needs: beginning of the message, such as "ROS bags need".
    """
    if find_spec(module) is None:
        raise InputError(f"{needs} {module}: {pip_line(extra)}")


def pip_line(extra: str) -> str:
    return f'pip install "visuotactile-slip-rig[{extra}]"'
