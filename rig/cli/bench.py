"""`rig bench`: bench files."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import say
from rig.cli.helping import Commands

bench = Commands(no_args_is_help=True, help="Bench files: what a bench is made of.")


@bench.callback()
def _bench() -> None:
    """Bench files: what a bench is made of."""


@bench.command("new")
def new(file: Annotated[Path, typer.Argument(help="The file to write, as my_bench.toml.")]) -> None:
    """Write a bench file that explains each of its keys; fill in yours.

    Examples:
      rig bench new my_bench.toml

      rig doctor --bench my_bench.toml

    """
    from rig.config.load import new_bench_file

    new_bench_file(file)
    say(f"put in your addresses, serials and positions, then run: rig doctor --bench {file}")
    print(file)


@bench.command("udev")
def udev() -> None:
    """Print udev rules: access to the sensors and the gripper's serial adapter, and names for them.

    Examples:
      rig bench udev | sudo tee /etc/udev/rules.d/70-slip-rig.rules

    """
    from importlib.resources import files

    print(files("rig.bench").joinpath("70-slip-rig.rules").read_text(encoding="utf-8"), end="")
