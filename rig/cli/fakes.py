"""`rig fakes`: serve simulated devices over the wire protocols of the real ones."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import OperatorStopError
from rig.cli.common import print_result, say
from rig.cli.helping import Commands
from rig.cli.options import JsonOption, ObjectsOption, SeedOption
from rig.declared import file_place, option

fakes = Commands(
    no_args_is_help=True,
    help="Serve simulated devices over the wire protocols of the real ones, in one simulated world.",
)
ServedBench = Annotated[str, typer.Option("--bench", help="Bench file that 'rig fakes serve' wrote.")]


@dataclass(frozen=True, slots=True)
class ServeOptions:
    bench: str = option("wire", "Bench with the devices: wire, or a bench file with a table \\[fakes].")
    host: str = option("127.0.0.1", "Loopback address of the devices; use another one for a second bench.")
    polyscope: str = option("5.11.0", "PolyScope version that the controller reports.")
    write: Path | None = option(None, "Also write the printed bench file to this path.", callback=file_place)
    seed: SeedOption = 0


@fakes.command("serve")
def serve(options: ServeOptions) -> None:
    """Start a simulated controller, gripper, two DIGITs and camera; print a bench file for them.

    Runs until Ctrl-C. Use the other commands below in a second terminal, to lift, place objects and inject
    faults.

    Examples:
      rig fakes serve --write fakes.toml
      rig fakes serve --host 127.0.0.2 --polyscope 5.25.0 --write second.toml
      rig trial --bench fakes.toml --lifts 1 --object wrench
      rig fakes place wrench --bench fakes.toml
      rig fakes fault arm protective_stop --bench fakes.toml
    """
    from rig.bench.fakes_process import hosted_fakes
    from rig.config import load_bench
    from rig.config.write import bench_text, write_bench

    try:
        with hosted_fakes(load_bench(options.bench), options.host, options.seed, options.polyscope) as (
            served,
            running,
        ):
            if options.write is not None:
                write_bench(options.write, served)
            print(bench_text(served), flush=True)
            say("SIMULATED devices are served; press Ctrl-C to end them")
            if options.write is not None:
                trial = f"rig trial --lifts 1 --object wrench --bench {shlex.quote(str(options.write))}"
                say(f"next, in another terminal: {trial}")
            running.wait()
    except OperatorStopError:
        say("the simulated devices have ended")


@fakes.command("place")
def place(
    name: Annotated[str, typer.Argument(metavar="OBJECT", help="Object id or name.")],
    bench: ServedBench,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Seed of the object's pose and of its slip.")
    ] = None,
    objects: ObjectsOption = None,
) -> None:
    """Place an object in the world of running simulated devices.

    An object of your own is simulated as a plain shape.

    Examples:
      rig fakes place wrench --bench fakes.toml
    """
    from rig.bench.fakes_process import fakes_control
    from rig.bench.twins import laid_as
    from rig.config import load_bench
    from rig.config.objects import with_objects

    config = with_objects(load_bench(bench), bench, objects)
    own = next((each.id for each in config.objects if name.lower() in each.names), name)
    fakes_control(config).call("place", object=laid_as(config.objects, own), seed=seed)


@fakes.command("fault")
def fault(
    device: Annotated[str, typer.Argument(help="arm, gripper, tactile, camera, a serial, or all.")],
    kind: Annotated[
        str, typer.Argument(help="Kind of fault; clear ends all faults. An unknown kind prints the list.")
    ],
    bench: ServedBench,
) -> None:
    """Inject a fault into running simulated devices, or clear all faults.

    Examples:
      rig fakes fault SIM-D0001 freeze --bench fakes.toml
      rig fakes fault all clear --bench fakes.toml
    """
    from rig.bench.fakes_process import fakes_control
    from rig.config import load_bench

    fakes_control(load_bench(bench)).call("fault", device=device, kind=kind)


@fakes.command("status")
def status(bench: ServedBench, json: JsonOption = False) -> None:
    """Print the true state of the simulated world: tool, fingers, object, and counts of each device.

    Examples:
      rig fakes status --bench fakes.toml --json
    """
    from rig.bench.fakes_process import fakes_control, state_lines
    from rig.config import load_bench

    state = fakes_control(load_bench(bench)).call("status")
    print_result(json, state, *state_lines(state))
