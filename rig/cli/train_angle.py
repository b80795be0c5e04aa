"""`rig train-angle`: train the peers' networks that tell an angle (extra `train`)."""

from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli.common import JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place


def train_angle(
    network: Annotated[
        str, typer.Argument(help="anglenet (an angle from one image) or toskov (from the wrist's wrench).")
    ],
    out: Annotated[
        Path,
        typer.Option("--out", help="Empty folder for the ONNX file and its card.", callback=folder_place),
    ],
    data: Annotated[
        list[Path] | None,
        typer.Option("--data", help="Session of rig trial; repeat for more. Default: SIMULATED lifts."),
    ] = None,
    lifts: Annotated[
        int | None,
        typer.Option(min=1, help="Simulated lifts of each object. Default: toskov 120, anglenet 5."),
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Default: toskov 120, anglenet 8.")] = None,
    on_test_lifts: Annotated[
        bool,
        typer.Option(
            "--on-test-lifts",
            help="Learn from the lifts of --data that are then scored, as the paper trained AngleNet. "
            "Default: the trial's objects are scored and never learnt from.",
        ),
    ] = False,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads. Default: torch's own.")] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Train a network of the paper's peers (its Table IV) that tells an angle, and export it to ONNX.

    OUT gets model.onnx and card.json; rig benchmark trials takes it with --model anglenet=FILE or
    toskov=FILE. Needs the extra `train`.

    Examples:
      rig train-angle toskov --out runs/toskov

      rig train-angle anglenet --data sessions/others --data sessions/trial --out runs/anglenet

      rig train-angle anglenet --data trials/session --on-test-lifts --out runs/anglenet-on-test

    """
    from rig.cli.train import TrainingView, require_training

    require_training()
    from drivers.errors import unknown_name
    from rig.training.angles import EPOCHS, LIFTS, AngleSettings, train_angles

    if network not in LIFTS:
        raise unknown_name("network", network, LIFTS)
    settings = AngleSettings(
        name=network,
        sessions=tuple(data or ()),
        lifts=lifts or LIFTS[network],
        epochs=epochs or EPOCHS[network],
        seed=seed,
        on_test_lifts=on_test_lifts,
        threads=threads,
    )
    what = ", ".join(map(str, settings.sessions)) or "SIMULATED lifts"
    say(f"{network} from {what}, seed {seed}, into {out}")
    with TrainingView() as view:
        card = train_angles(out, settings, view)
    say(_told(card))
    if json:
        emit_json({"out": str(out), **card})
    else:
        print(out / "model.onnx")


def _told(card: dict[str, Any]) -> str:
    """Say how well it does, and on what."""
    test, title = card["test"], f"{card['title']}, {card['parameters']} parameters"
    scored = "the lifts it learnt from" if card["trained_on_test_lifts"] else "objects it never saw"
    simulated = "SIMULATED: " if card["simulated"] else ""
    return (
        f"{simulated}{title}: off by {test['error_deg']:.2f} deg in the mean on "
        f"{scored}; 0 all the time is off by {test['saying_zero_deg']:.2f} deg"
    )
