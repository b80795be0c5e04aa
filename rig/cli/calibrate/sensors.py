"""`rig calibrate tactile, gripper, tcp, sync`: gels, fingers, the tool's tip, clocks."""

from dataclasses import dataclass

import typer

from rig.cli.calibrate.options import StationOptions, calibrated
from rig.cli.declared import is_given, option
from rig.cli.options import ObjectsOption

_BLOCKS_MM = [8.0, 15.0, 25.0, 35.0, 50.0, 65.0, 80.0, 95.0]


@dataclass(frozen=True, slots=True)
class TactileOptions:
    """The balls, and the sensor."""

    balls_mm: list[float] | None = option(
        None, "Diameter of a ball to press on a bench; two sizes are good. Repeat.", "--ball-mm"
    )
    presses: int = option(16, "Places for each ball.", min=8, max=100)
    mm_per_px: tuple[float, float] | None = option(
        None, "With --from: scale along x and y, where it is known."
    )
    serial: str = option("unknown", "Of the sensor.")


def tactile(context: typer.Context, common: StationOptions, options: TactileOptions) -> None:
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

    balls_mm = options.balls_mm
    calibrated(
        context,
        common,
        ("presses", options.presses * len(balls_mm)) if balls_mm else ("fingertips", 2),
        lambda at: collect_presses(at, balls_mm, options.presses) if balls_mm else collect_references(at),
        lambda samples: tactile_from_folder(samples, options.serial, options.mm_per_px),
        needs="rig calibrate tactile --ball-mm" if balls_mm else "",
        agreed=not balls_mm,  # without balls nothing moves, so there is nothing to agree to
    )


@dataclass(frozen=True, slots=True)
class GripperOptions:
    """The blocks, and the gripper."""

    blocks_mm: list[float] | None = option(
        None, "Width of a block to close on at a bench. Repeat.", "--block-mm"
    )
    serial: str = option("unknown", "Of the gripper.")


def gripper(context: typer.Context, common: StationOptions, options: GripperOptions) -> None:
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

    blocks_mm = options.blocks_mm or _BLOCKS_MM
    calibrated(
        context,
        common,
        ("contacts", 2 * len(blocks_mm)),
        lambda at: collect_openings(at, blocks_mm),
        lambda samples: gripper_from_folder(samples, options.serial),
    )


@dataclass(frozen=True, slots=True)
class TcpOptions:
    """The tilts, and the tool."""

    poses: int = option(12, "Tilts on a bench.", min=4, max=60)
    serial: str = option("unknown", "Of the tool.")
    accept_change: bool = option(
        False, "Accept a tip over 50 mm from the bench file's tcp_m; --yes does not."
    )


def tcp(context: typer.Context, common: StationOptions, options: TcpOptions) -> None:
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

    flange = is_given(context, "bench")
    calibrated(
        context,
        common,
        ("tilts", options.poses),
        lambda at: collect_tip(at, options.poses, options.accept_change),
        lambda samples: tip_from_folder(
            samples,
            options.serial,
            load_bench(common.bench).arm.flange_T_tcp() if flange else None,
            options.accept_change,
        ),
    )


@dataclass(frozen=True, slots=True)
class SyncOptions:
    """The streams, and the object that carries the markers."""

    first: str = option("robot", "Stream whose clock counts.", "--reference")
    second: str = option("camera", "Stream to be moved.", "--stream")
    search: float = option(0.5, "Largest offset, s.", min=0.01, max=10)
    object_name: str = option(
        "gauge:30", "What carries the markers on a bench: a block by its width, or an object.", "--object"
    )
    objects: ObjectsOption = None


def sync(context: typer.Context, common: StationOptions, options: SyncOptions) -> None:
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

    calibrated(
        context,
        common,
        ("wiggles", 1),
        lambda at: collect_streams(at, options.object_name, options.search),
        lambda samples: sync_from_folder(samples, options.first, options.second, options.search),
        objects=options.objects,
    )
