"""Prove that a bench over the wire protocol is simulated, device by device.

If [fakes] were left in the file of a real bench by mistake, a simulated operator would agree to everything.
So the fakes' side channel must answer, on this computer's loopback, with the address of every device that is
about to be driven.
"""

from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from drivers.clock import is_loopback
from drivers.errors import DeviceError, InputError
from fakes.wire.net import Control
from rig.config import BenchConfig
from rig.config.devices import DigitConfig, RobotiqConfig, RobotiqRtuConfig, UR5eConfig, VideoCameraConfig


def prove_simulated(config: BenchConfig) -> None:
    """Return if every device of a bench is served by running fakes.

    Otherwise raise `InputError` naming the device: the bench is real, and [fakes] a mistake.
    """
    reason = next(_doubts(config), None)
    if reason is not None:
        raise InputError(
            f"bench '{config.name}': according to [fakes] its devices are simulated, but {reason}. Without "
            "[fakes] it is a real bench, and a person is asked before anything moves; for simulated "
            "devices start 'rig fakes serve --write FILE' and give that FILE"
        )


def _doubts(config: BenchConfig) -> Iterator[str]:
    """Yield reasons why a bench may not be simulated."""
    control = config.fakes.control if config.fakes is not None else None
    if control is None:
        yield "it has no side channel of running fakes"
        return
    if not is_loopback(control.rpartition(":")[0]):
        yield f"their side channel, {control}, is not on this computer"
        return
    try:
        served = Control(control).call("identity")
    except (DeviceError, InputError) as error:
        yield str(error)
        return
    for device, address, host in _devices(config):
        if host is not None and not is_loopback(host):
            yield f"{device} at {address} is not on this computer"
        elif address != served.get(device):
            yield f"{device} at {address} is not one of the fakes (they serve {served.get(device)})"


def _devices(config: BenchConfig) -> Iterator[tuple[str, Any, str | None]]:
    """Yield each device, its address in the bench file (as JSON), and its host (None for a path)."""
    for where, device in config.devices:
        name = getattr(device, "serial", str(where[0]))
        if isinstance(device, UR5eConfig):
            yield name, device.host, device.host or ""
        elif isinstance(device, RobotiqConfig):
            yield name, [device.host, device.port], device.host or ""
        elif isinstance(device, RobotiqRtuConfig):
            yield name, device.device, None
        elif isinstance(device, DigitConfig | VideoCameraConfig):
            yield name, device.address, urlsplit(device.address or "").hostname or ""
