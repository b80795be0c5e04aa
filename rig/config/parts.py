"""Which devices a bench has, and which of them a command needs.

A bench file may lack any device. `NEEDS` lists what each command needs; `require_parts` rejects a bench that
lacks it, and lists the commands that work.
"""

from collections.abc import Iterator, Mapping

from drivers.errors import InputError
from rig.config.models import BenchConfig

FINGERTIP, FINGERTIPS = "[[tactile]]", "two [[tactile]]"
WHOLE = ("[arm]", "[gripper]", FINGERTIPS, "[camera]")
"""Both tactile images stop the closing fingers; arm and gripper are checked with each camera picture."""
CARRIES = ("[arm]", "[gripper]")
"""The arm moves only after the gripper has been read, because the hand may hold an object."""
NEEDS: Mapping[str, tuple[str, ...]] = {
    "rig doctor": (),
    "rig live": (),
    "rig record --by hand": (FINGERTIP,),
    "rig calibrate tactile": (FINGERTIP,),
    "rig calibrate camera": ("[camera]",),
    "rig calibrate markers": ("[camera]",),
    "rig trial": WHOLE,
    "rig record": WHOLE,
    "rig teach": WHOLE,
    "rig calibrate tactile --ball-mm": WHOLE,
    "rig calibrate gripper": WHOLE,
    "rig calibrate sync": ("[camera]", FINGERTIP),
    "rig calibrate hand-eye": (*CARRIES, "[camera]"),
    "rig calibrate tcp": CARRIES,
}
"""Required sections of the bench file by command. Commands with [arm] move the arm."""


def lacking(config: BenchConfig, command: str) -> list[str]:
    """Return the sections that a command needs and a bench lacks, as in `NEEDS`."""
    count = {FINGERTIP: 1, FINGERTIPS: 2}
    return [
        each
        for each in NEEDS[command]
        if not (len(config.tactile) >= count[each] if each in count else config.has(each.strip("[]")))
    ]


def require_parts(config: BenchConfig, command: str) -> None:
    """Raise `InputError` if a bench lacks a section that a command of `NEEDS` needs, or must not move.

    A bench with both simulated and real devices does not move, because real sensors cannot observe the motion
    of a simulated arm.
    """
    missing = lacking(config, command)
    if missing:
        listed = " and ".join(filter(None, [", ".join(missing[:-1]), missing[-1]]))
        raise InputError(
            f"{command} needs {listed}, which bench '{config.name}' lacks: add "
            f"{'it' if len(missing) == 1 else 'them'} to the bench file (rig bench new FILE writes one that "
            f"explains each key). Without, these work: {', '.join(working(config))}"
        )
    if "[arm]" in NEEDS[command] and config.mixed:
        raise InputError(
            f"{command} moves the arm, and bench '{config.name}' has simulated devices "
            f"({', '.join(config.fake_devices)}) beside real ones: a real sensor does not observe a "
            "simulated arm. Make all drivers 'fake' or none. As it is, these work: "
            f"{', '.join(working(config))}"
        )


def working(config: BenchConfig) -> Iterator[str]:
    for command, needs in NEEDS.items():
        if not lacking(config, command) and not ("[arm]" in needs and config.mixed):
            yield command
