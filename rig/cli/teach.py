"""`rig teach`: teach the grasp positions of an object at the bench, instead of typing them."""

from dataclasses import dataclass
from typing import Literal

import typer

from rig.cli.common import Exit, mark, print_result, say
from rig.cli.options import BenchOptions, JsonOption
from rig.cli.resuming import dry_run
from rig.declared import argument, option
from rig.terminal.questions import ask, press, show_question
from rig.terminal.screen import begin_phase


@dataclass(frozen=True, slots=True)
class TeachOptions:
    name: str = argument(..., "Object of your own, by id or name.", metavar="OBJECT")
    positions: list[str] | None = option(
        None,
        "Position to teach, existing or new; repeat for more. Default: all positions in the file.",
        "--position",
    )
    by: Literal["hand", "keys"] = option(
        "hand", "hand: lead the arm by hand (freedrive). keys: move it in steps by keys."
    )
    lift_height: float | None = option(
        None, "Height of the lift in m. Default: you move the hand to it at the bench.", min=0.0, max=0.3
    )
    timeout: float = option(
        120.0, "Longest time for which the arm can be led by hand, s.", min=5.0, max=600.0
    )


def teach(what: TeachOptions, bench: BenchOptions, json: JsonOption = False) -> None:
    """Teach where an object is grasped, its width there, and the height of the lift.

    For each position you lead the arm by hand, or move it by keys, until the object is between the open
    fingers. The fingers then close until both fingertips detect contact, and you move the hand to the end of
    the lift. The position is checked against reach, limits, table, boxes and fingers, shown, and written to
    the object's file. Comments in the file are kept.

    The rig asks before each motion. --yes does not answer questions for which you have to check the bench.
    After Ctrl-C, a lost terminal or the time limit the arm stands still under position control.

    Examples:
      rig objects new objects/my_box.toml
      rig teach my_box --bench my_bench.toml --dry-run
      rig teach my_box --bench my_bench.toml
      rig teach my_box --bench my_bench.toml --by keys --position left --lift-height 0.05
    """
    from drivers.errors import OperatorStopError
    from drivers.formats import write_whole
    from rig.bench.operators import ConsoleOperator
    from rig.calibrate import teaching
    from rig.config.objects import own_object, with_position

    config = bench.config("rig teach")
    file, grasps = own_object(what.name, bench.bench, bench.own_objects)
    places = tuple(dict.fromkeys(what.positions or [place.name for place in grasps.position]))
    say(f"{mark(config.simulated)}bench '{config.name}', object {grasps.id} {grasps.name}, file {file}")
    lesson = teaching.Lesson(config, grasps, places, what.by == "hand", what.timeout, what.lift_height)
    if bench.dry:
        dry_run(config, teaching.teaching_plan(lesson), json)
    person = ConsoleOperator(ask, agreed=bench.yes, wait=show_question, press=press)
    begin_phase("preparing the bench")
    found = teaching.teach(lesson, person, say, bench.seed)
    good = [each for each in found if not each.problems]
    if good:
        if not bench.yes and not ask(f"Write {', '.join(each.name for each in good)} into {file}?"):
            raise OperatorStopError(f"stopped: {file} was not changed")
        text = file.read_text(encoding="utf-8")
        for each in good:
            text, _ = with_position(text, each.name, each.values, str(file))
        write_whole(file, text.encode())
    figures = {
        "file": str(file),
        "simulated": config.simulated,
        "written": [each.name for each in good],
        "positions": [{"name": f.name, **f.values, "problems": list(f.problems)} for f in found],
    }
    print_result(json, figures, file)
    if len(good) < len(found):
        say(f"rig: {len(found) - len(good)} of {len(found)} positions were not written; teach them again")
        raise typer.Exit(Exit.USAGE)
