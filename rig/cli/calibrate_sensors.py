"""`rig calibrate tactile, gripper, tcp, sync`: gels, fingers, the tool's tip, clocks."""

from typing import Annotated

import typer

from rig.cli.calibrate_options import (
    FromOption,
    OutFolder,
    calibrations_folder,
    file_and_say,
    filed_and_said,
    samples_folder,
)
from rig.cli.common import BenchOption, JsonOption, SeedOption, emit_json


def tactile(
    source: FromOption = None,
    mm_per_px: Annotated[
        tuple[float, float], typer.Option("--mm-per-px", help="Scale along x and y of the picture.")
    ] = (0.06, 0.06),
    serial: Annotated[str, typer.Option("--serial", help="Of the sensor.")] = "unknown",
    bench: BenchOption = "fake",
    seed: SeedOption = 0,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Fit how a gel's colours tell its slopes, from ball presses: background.png, catalog.csv, pictures.

    catalog.csv: image, diameter(mm). The balls are found by themselves. Without --from every
    fingertip of the bench is looked at untouched: its reference, and what changed since the last.

    Examples:
      rig calibrate tactile --from gelsight_ball --mm-per-px 0.0634 0.0634 --serial GS1

    """
    from rig.calibrate.bench_tactile import collect_references
    from rig.calibrate.sensors import tactile_from_folder

    if source is not None:
        file_and_say(tactile_from_folder(source, serial, mm_per_px), out, bench, json)
        return
    filed = [
        filed_and_said(outcome, out, bench)
        for outcome in collect_references(bench, seed, calibrations_folder(out, bench))
    ]
    if json:
        emit_json({"references": [each.figures for each in filed]})
    else:
        for each in filed:
            print(each.path, each.page, sep="\n")


def gripper(
    source: FromOption = None,
    serial: Annotated[str, typer.Option("--serial", help="Of the gripper.")] = "unknown",
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Make the table of opening over counts, from gripper.csv: counts, opening_mm, direction.

    force.csv (signal, force_n), where there is one, is made a table too.

    Examples:
      rig calibrate gripper --from measured --serial R3F-1

    """
    from rig.calibrate.tables import gripper_from_folder

    file_and_say(gripper_from_folder(samples_folder(source, "gripper"), serial), out, "fake", json)


def tcp(
    source: FromOption = None,
    serial: Annotated[str, typer.Option("--serial", help="Of the tool.")] = "unknown",
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Find the tool's tip from poses.csv, taken while the tip rested in one hole at different tilts.

    Examples:
      rig calibrate tcp --from pivot

    """
    from rig.calibrate.tables import tcp_from_folder

    file_and_say(tcp_from_folder(samples_folder(source, "tcp"), serial), out, "fake", json)


def sync(
    source: FromOption = None,
    first: Annotated[str, typer.Option("--reference", help="Stream whose clock counts.")] = "robot",
    second: Annotated[str, typer.Option("--stream", help="Stream to be moved.")] = "camera",
    search: Annotated[float, typer.Option("--search", min=0.01, max=10, help="Largest offset, s.")] = 0.5,
    out: OutFolder = None,
    json: JsonOption = False,
) -> None:
    """Find the time offset between two recordings of one wiggle: <name>.csv with time_ns (or t_s) and value.

    Examples:
      rig calibrate sync --from wiggle --reference robot --stream camera

    """
    from rig.calibrate.tables import sync_from_folder

    file_and_say(sync_from_folder(samples_folder(source, "sync"), first, second, search), out, "fake", json)
