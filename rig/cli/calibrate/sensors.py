"""`rig calibrate tactile, gripper, tcp, sync`: gels, fingers, the tool's tip, clocks."""

from typing import Annotated

import typer

from rig.cli.calibrate.options import (
    StationOptions,
    file_all,
    file_and_say,
    recorded,
    station,
)
from rig.cli.common import ObjectsOption
from rig.cli.declared import is_given

_BLOCKS_MM = [8.0, 15.0, 25.0, 35.0, 50.0, 65.0, 80.0, 95.0]


def tactile(
    context: typer.Context,
    common: StationOptions,
    balls_mm: Annotated[
        list[float] | None,
        typer.Option("--ball-mm", help="Diameter of a ball to press on a bench; two sizes are good. Repeat."),
    ] = None,
    presses: Annotated[int, typer.Option("--presses", min=8, max=100, help="Places for each ball.")] = 16,
    mm_per_px: Annotated[
        tuple[float, float] | None,
        typer.Option("--mm-per-px", help="With --from: scale along x and y, where it is known."),
    ] = None,
    serial: Annotated[str, typer.Option("--serial", help="Of the sensor.")] = "unknown",
) -> None:
    """Find a gel's scale along x and y, and how its colours tell its slopes, from ball presses.

    On a bench with --ball-mm the fingers press each ball at many places of both gels; the arm's steps
    give the scale. Without --ball-mm nothing moves: every fingertip is looked at untouched, kept as
    its reference, and compared with the one before (LEDs, gel, drift).

    The folder of --from holds background.png (untouched), catalog.csv and its pictures. catalog.csv:
    image, diameter(mm); where known x_mm, y_mm (how far the ball was moved, right and down as the
    picture shows it: they give mm per px) and background (another untouched picture for this one).
    The balls are found by themselves.

    Examples:
      rig calibrate tactile --bench fake

      rig calibrate tactile --bench fake --ball-mm 5 --ball-mm 9.5

      rig calibrate tactile --from gelsight_ball --mm-per-px 0.0634 0.0634 --serial GS1

    """
    from rig.calibrate.bench_tactile import collect_presses, collect_references
    from rig.calibrate.tactile import tactile_from_folder

    if common.source is not None:
        file_and_say(tactile_from_folder(recorded(common.source, common), serial, mm_per_px), common)
    elif balls_mm:
        with station(context, common, "presses", presses * len(balls_mm)) as at:
            file_all(collect_presses(at, balls_mm, presses), common)
    else:
        # nothing moves, so there is nothing to agree to
        with station(context, common, "fingertips", 2, agreed=True) as at:
            file_all(collect_references(at), common)


def gripper(
    context: typer.Context,
    common: StationOptions,
    blocks_mm: Annotated[
        list[float] | None,
        typer.Option("--block-mm", help="Width of a block to close on at a bench. Repeat."),
    ] = None,
    serial: Annotated[str, typer.Option("--serial", help="Of the gripper.")] = "unknown",
) -> None:
    """Make the table of opening over counts of closing fingers, monotone, and measure the hysteresis.

    On a bench the fingers close on blocks of known width (8 to 95 mm, or --block-mm) until both gels
    feel them, and open until they do not.

    The folder of --from holds gripper.csv: counts, opening_mm, direction (closing or opening).

    Examples:
      rig calibrate gripper --bench fake

      rig calibrate gripper --from measured --serial R3F-1

    """
    from rig.calibrate.bench_fingers import collect_openings
    from rig.calibrate.from_tables import gripper_from_folder

    if common.source is not None:
        file_and_say(gripper_from_folder(recorded(common.source, common), serial), common)
    else:
        blocks_mm = blocks_mm or _BLOCKS_MM
        with station(context, common, "contacts", 2 * len(blocks_mm)) as at:
            file_and_say(collect_openings(at, blocks_mm), common)


def tcp(
    context: typer.Context,
    common: StationOptions,
    poses: Annotated[int, typer.Option("--poses", min=4, max=60, help="Tilts on a bench.")] = 12,
    serial: Annotated[str, typer.Option("--serial", help="Of the tool.")] = "unknown",
    accept_change: Annotated[
        bool,
        typer.Option(
            "--accept-change", help="Accept a tip over 50 mm from the bench file's tcp_m; --yes does not."
        ),
    ] = False,
) -> None:
    """Find the point of a tip clamped in the fingers, on the flange, by pivoting in one small hole.

    On a bench a pointed tip is in the fingers; the arm tilts it over the hole, and you step it in by
    typing how far it still has to go (x y z in mm, base axes; empty when it sits).

    The tip is not tcp_m, the point between the gels: it stands out of them. The result shows both, and the
    way from tcp_m to the tip along the tool's axes. A calliper measures the same from the middle of the
    gels to the point; where it differs, correct tcp_m by the difference. The result does not depend on
    tcp_m, and is refused if it is more than 50 mm from it.

    The folder of --from holds poses.csv, one row for each seated pose: id, x_m, y_m, z_m and qx, qy,
    qz, qw (or rx_rad, ry_rad, rz_rad, as a UR shows them), and child_frame: flange, or tcp for poses of the
    tool centre point that the --bench file states. With --bench the tip is compared with its tcp_m.

    Examples:
      rig calibrate tcp --bench fake

      rig calibrate tcp --from pivot

    """
    from rig.calibrate.bench_tip import collect_tip
    from rig.calibrate.clamped_tip import tip_from_folder
    from rig.config import load_bench

    if common.source is not None:
        tool = load_bench(common.bench).arm.flange_T_tcp() if is_given(context, "bench") else None
        found = tip_from_folder(recorded(common.source, common), serial, tool, accept_change)
        file_and_say(found, common)
    else:
        with station(context, common, "tilts", poses) as at:
            file_and_say(collect_tip(at, poses, accept_change), common)


def sync(
    context: typer.Context,
    common: StationOptions,
    first: Annotated[str, typer.Option("--reference", help="Stream whose clock counts.")] = "robot",
    second: Annotated[str, typer.Option("--stream", help="Stream to be moved.")] = "camera",
    search: Annotated[float, typer.Option("--search", min=0.01, max=10, help="Largest offset, s.")] = 0.5,
    object_name: Annotated[
        str,
        typer.Option(
            "--object", help="What carries the markers on a bench: a block by its width, or an object."
        ),
    ] = "gauge:30",
    objects: ObjectsOption = None,
) -> None:
    """Find the time offset, and the drift, between streams that saw one wiggle.

    On a bench the arm holds an object with markers and moves it up and down by a centimetre; the
    camera and both fingertips are put on the arm's clock.

    The folder of --from holds <name>.csv of both streams: time_ns (or t_s) and value, anything that
    the motion changes; the longer, faster and less regular, the better. Or an orientation, qx, qy, qz, qw:
    then how fast it turns is compared, which two sensors on one body see alike.

    Examples:
      rig calibrate sync --bench fake

      rig calibrate sync --from wiggle --reference robot --stream camera

    """
    from rig.calibrate.bench_clocks import collect_streams
    from rig.calibrate.from_tables import sync_from_folder

    if common.source is not None:
        samples = recorded(common.source, common)
        file_and_say(sync_from_folder(samples, first, second, search), common)
    else:
        with station(context, common, "wiggles", 1, objects=objects) as at:
            file_all(collect_streams(at, object_name, search), common)
