"""Addresses of this computer's loopback network: a controller's ports are fixed, addresses are many."""

import os
import socket
from contextlib import ExitStack

from drivers.errors import InputError

CONTROLLER_PORTS = (29999, 30001, 30002, 30003, 30004)
ADDRESSES = tuple(f"127.0.0.{number}" for number in range(1, 33))


def free_address() -> str:
    """Return an address whose controller ports are free. Raises `InputError` when none is.

    Each process begins to look at another address: two that look at once do not take the same one.
    """
    first = os.getpid() % len(ADDRESSES)
    for address in (*ADDRESSES[first:], *ADDRESSES[:first]):
        if not taken_ports(address):
            return address
    raise InputError(
        f"no free loopback address from {ADDRESSES[0]} to {ADDRESSES[-1]}: end other fakes first"
    )


def require_free(address: str) -> None:
    """Raise `InputError` unless a controller can be served there, for this computer alone."""
    if not address.startswith("127."):
        raise InputError(
            f"{address} is no loopback address: fakes are for this computer alone, use 127.0.0.1"
        )
    taken = taken_ports(address)
    if taken:
        ports = ", ".join(map(str, taken))
        raise InputError(
            f"{address}: port {ports} cannot be served (in use?); give another, as --host 127.0.0.2"
        )


def taken_ports(address: str) -> list[int]:
    """Return the controller ports that something else serves, or that cannot be served at all."""
    with ExitStack() as stack:
        return [port for port in CONTROLLER_PORTS if not _can_bind(stack, address, port)]


def _can_bind(stack: ExitStack, address: str, port: int) -> bool:
    probe = stack.enter_context(socket.socket())
    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        probe.bind((address, port))
        probe.listen()
    except OSError:
        return False
    return True
