"""`rig fakes`: simulated devices that speak the wire protocols of the real ones."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli.common import JsonOption, ObjectsOption, SeedOption, emit_json, say
from rig.cli.helping import Commands
from rig.cli.places import file_place

fakes = Commands(
    no_args_is_help=True, help="Simulated devices behind the real wire protocols, on one shared world."
)
TOLD = (
    "robot_mode", "safety_mode", "remote_control", "program_running", "requests", "replies", "served",
    "missed", "withheld", "clients", "faults",
)  # fmt: skip
"""What people are told of each fake; --json has all of it."""
ServedBench = Annotated[str, typer.Option("--bench", help="The bench file that 'rig fakes serve' wrote.")]


@fakes.command("serve")
def serve(
    bench: Annotated[
        str, typer.Option("--bench", help="wire, or a bench file with \\[fakes]: which devices, where.")
    ] = "wire",
    host: Annotated[
        str, typer.Option("--host", help="Loopback address; another one for a second bench.")
    ] = "127.0.0.1",
    polyscope: Annotated[
        str, typer.Option("--polyscope", help="Version that the controller announces.")
    ] = "5.11.0",
    write: Annotated[
        Path | None,
        typer.Option("--write", help="Also write the bench file to this file.", callback=file_place),
    ] = None,
    seed: SeedOption = 0,
) -> None:
    """Start a controller, a gripper, two DIGITs and a camera; print the bench file that reaches them.

    Ends with Ctrl-C. What a person would do at the bench is done from another terminal:

    Examples:
      rig fakes serve --write fakes.toml

      rig fakes serve --host 127.0.0.2 --polyscope 5.25.0 --write second.toml

      rig trial --bench fakes.toml --lifts 1 --object wrench

      rig fakes place wrench --bench fakes.toml

      rig fakes fault arm protective_stop --bench fakes.toml

    """
    from drivers.errors import OperatorStopError
    from rig.bench.fakes_process import hosted_fakes
    from rig.config import load_bench
    from rig.config.write import bench_text, write_bench

    try:
        with hosted_fakes(load_bench(bench), host, seed, polyscope) as (served, running):
            if write is not None:
                write_bench(write, served)
            print(bench_text(served), flush=True)
            say("SIMULATED devices are served; Ctrl-C ends them")
            if write is not None:
                trial = f"rig trial --lifts 1 --object wrench --bench {shlex.quote(str(write))}"
                say(f"next, in another terminal: {trial}")
            running.wait()
    except OperatorStopError:
        say("the fakes have ended")


@fakes.command("place")
def place(
    name: Annotated[str, typer.Argument(metavar="OBJECT", help="Object id or name.")],
    bench: ServedBench,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="How it lies, and how it slips.")] = None,
    objects: ObjectsOption = None,
) -> None:
    """Lay an object down in the world of running fakes; one of your own as a plain shape.

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
        str, typer.Argument(help="What goes wrong; 'clear' ends all faults. A wrong one lists them.")
    ],
    bench: ServedBench,
) -> None:
    """Let something go wrong at running fakes.

    Examples:
      rig fakes fault SIM-D0001 freeze --bench fakes.toml

      rig fakes fault all clear --bench fakes.toml

    """
    from rig.bench.fakes_process import fakes_control
    from rig.config import load_bench

    fakes_control(load_bench(bench)).call("fault", device=device, kind=kind)


@fakes.command("status")
def status(bench: ServedBench, json: JsonOption = False) -> None:
    """Say how the simulated world truly is: tool, fingers, object, and what each fake has served.

    Examples:
      rig fakes status --bench fakes.toml --json

    """
    from rig.bench.fakes_process import fakes_control
    from rig.config import load_bench

    state = fakes_control(load_bench(bench)).call("status")
    if json:
        emit_json(state)
        return
    print("\n".join(_for_people(state)))


def _for_people(state: Mapping[str, Any]) -> list[str]:
    """Write the state of the world in lines: what it is, and what each device has served."""
    x, y, z = state["tool_m"]
    held = f"held with {state['force_n']:.2f} N" if state["held"] else "not held"
    turned = f"turned {state['turn_deg']:+.1f} deg"
    lines = [
        f"tool at ({x:.3f}, {y:.3f}, {z:.3f}) m, {'moving' if state['tool_moving'] else 'at rest'}",
        f"fingers at {state['finger_counts']:.0f} counts",
        "no object" if state["object"] is None else f"object {state['object']}, {held}, {turned}",
    ]
    for name, counted in state["devices"].items():
        told = (f"{key.replace('_', ' ')} {_word(counted[key])}" for key in TOLD if key in counted)
        lines.append(f"{name}: {', '.join(told)}")
    return lines


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)
