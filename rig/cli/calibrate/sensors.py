"""`rig calibrate tactile, gripper, tcp, sync`: calibrate gels, fingers, the tool's tip, and clocks."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from rig.cli.calibrate.options import StationOptions, calibrated
from rig.cli.options import ObjectsOption
from rig.declared import argument, is_given, option

if TYPE_CHECKING:
    from rig.calibrate.result import CalibrationResult

_BLOCKS_MM = [8.0, 15.0, 25.0, 35.0, 50.0, 65.0, 80.0, 95.0]
"""Default widths of the blocks on a bench."""


@dataclass(frozen=True, slots=True)
class TactileOptions:
    """The presses, the balls, and the sensor."""

    folder: Path | None = argument(None, "Folder of photographs of pressed balls; as --from.")
    balls_mm: list[float] | None = option(
        None, "On a bench: diameter of a ball to press, in mm; repeat for a second size.", "--ball-mm"
    )
    presses: int = option(16, "Number of presses of each ball.", min=8, max=100)
    mm_per_px: tuple[float, float] | None = option(
        None, "With --from: scale along x and y in mm per px, if known."
    )
    serial: str = option("unknown", "Serial of the sensor.")
    background: Path | None = option(None, "Picture without contact. Default: background.png of the folder.")
    circles: Path | None = option(
        None,
        "CSV of hand-drawn circles: frame, center_x, center_y, radius (px). Default: circles.csv, if any.",
    )
    untouched: Path | None = option(
        None, "Folder of at least 8 frames without contact, for noise and background. Default: the presses'."
    )


def tactile(context: typer.Context, common: StationOptions, options: TactileOptions) -> None:
    """Calibrate a gel's scale and its map from colour to surface slope, from presses of balls.

    On a bench with --ball-mm the fingers press each ball at many places of both gels. The scale in mm per px
    is found from the steps of the arm. Without --ball-mm nothing moves: a frame of each fingertip without
    contact is stored as its reference, and compared with the previous reference (LEDs, gel, drift).

    The folder of --from holds background.png (without contact), catalog.csv and the pictures that it lists.
    Its columns are image and diameter(mm). Optional columns are x_mm and y_mm (position of the ball, to the
    right and down in the picture, from which the scale is found), and background (a picture without contact
    for this row). The balls are detected in the pictures. Without catalog.csv, --ball-mm is the diameter
    of the ball in all pictures.

    The look of the sensor is stored beside the file, in tactile-SERIAL.npz: its colours by slope and place,
    background, noise and JPEG quality. The key tactile.look of a bench file simulates a gel with it.

    Examples:
      rig calibrate tactile presses --ball-mm 8.8 --background bg.png --serial D20641

      rig calibrate tactile --bench fake

      rig calibrate tactile --bench fake --ball-mm 5 --ball-mm 9.5

      rig calibrate tactile --from gelsight_ball --mm-per-px 0.0634 0.0634 --serial GS1

    """
    from drivers.errors import InputError
    from rig.calibrate.bench_tactile import collect_presses, collect_references
    from rig.calibrate.tactile import tactile_from_folder

    balls_mm, source = options.balls_mm, options.folder or common.source
    if source and balls_mm and len(balls_mm) > 1:
        raise InputError("--ball-mm was given twice: name each picture's ball in catalog.csv instead")
    calibrated(
        context,
        replace(common, source=source),
        ("presses", options.presses * len(balls_mm)) if balls_mm else ("fingertips", 2),
        lambda at: collect_presses(at, balls_mm, options.presses) if balls_mm else collect_references(at),
        lambda samples: tactile_from_folder(
            samples,
            options.serial,
            options.mm_per_px,
            balls_mm[0] if balls_mm else None,
            options.background,
            options.circles,
            options.untouched,
        ),
        needs="rig calibrate tactile --ball-mm" if balls_mm else "",
        agreed=not balls_mm,  # without balls nothing moves, so no consent is needed
    )


@dataclass(frozen=True, slots=True)
class GripperOptions:
    """The blocks, and the gripper."""

    blocks_mm: list[float] | None = option(
        None, "On a bench: width in mm of a block to grasp; repeat for more.", "--block-mm"
    )
    serial: str = option("unknown", "Serial of the gripper.")


def gripper(context: typer.Context, common: StationOptions, options: GripperOptions) -> None:
    """Calibrate the gripper's opening in mm as a monotone function of its counts, and its hysteresis.

    On a bench the fingers close on blocks of known width (8 to 95 mm, or --block-mm) until both gels detect
    contact, then open until the contact is lost.

    The folder of --from holds gripper.csv with the columns counts, opening_mm and direction (closing or
    opening). Openings in another unit than mm are refused: they are compared with the range of the gripper
    of --bench.

    Examples:
      rig calibrate gripper --bench fake

      rig calibrate gripper --from measured --serial R3F-1

    """
    from rig.calibrate.bench_tip import collect_openings
    from rig.calibrate.from_tables import gripper_from_folder
    from rig.config import load_bench

    blocks_mm = options.blocks_mm or _BLOCKS_MM

    def solve(samples: Path) -> "CalibrationResult":
        step_m = load_bench(common.bench).gripper.limits.spec().resolution_m
        return gripper_from_folder(samples, options.serial, step_m)

    calibrated(
        context,
        common,
        ("contacts", 2 * len(blocks_mm)),
        lambda at: collect_openings(at, blocks_mm),
        solve,
    )


@dataclass(frozen=True, slots=True)
class TcpOptions:
    """The tilts, and the tool."""

    poses: int = option(12, "On a bench: number of tilts.", min=4, max=60)
    serial: str = option("unknown", "Serial of the tool.")
    accept_change: bool = option(
        False, "Accept a tip more than 50 mm from the bench file's tcp_m (--yes alone does not accept it)."
    )


def tcp(context: typer.Context, common: StationOptions, options: TcpOptions) -> None:
    """Calibrate the position of a clamped pointed tip in the flange frame, by pivoting it in a small hole.

    On a bench the fingers hold a pointed tip. The arm tilts it above the hole. You then step it into the hole
    by typing the remaining distance (x y z in mm, base axes), and press Enter alone when it sits.

    The tip is not the bench file's tcp_m, the point between the gels, because it sticks out of the fingers.
    The result gives both, and the vector from tcp_m to the tip along the tool's axes. Measure the same vector
    with a calliper, from the middle of the gels to the tip. If the two differ, correct tcp_m by the
    difference. The calibration does not use tcp_m; it is refused if the tip is more than 50 mm from it.

    The folder of --from holds poses.csv with a row per seated pose. The columns are id, x_m, y_m, z_m; qx,
    qy, qz, qw (or rx_rad, ry_rad, rz_rad, as a UR shows them); and child_frame, which is flange, or tcp for
    poses of the tool centre point of the --bench file. With --bench the tip is compared with its tcp_m.

    Examples:
      rig calibrate tcp --bench fake

      rig calibrate tcp --from pivot

    """
    from rig.calibrate.bench_tip import collect_tip
    from rig.calibrate.from_tables import tip_from_folder
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

    first: str = option("robot", "Stream whose clock is the reference.", "--reference")
    second: str = option("camera", "Stream whose offset from the reference is estimated.", "--stream")
    search: float = option(0.5, "Largest offset to search for, s.", min=0.01, max=10)
    object_name: str = option(
        "gauge:30", "On a bench: object with the markers, or gauge:WIDTH for a block (mm).", "--object"
    )
    objects: ObjectsOption = None


def sync(context: typer.Context, common: StationOptions, options: SyncOptions) -> None:
    """Estimate the time offset and drift between streams that measured the same motion.

    On a bench the arm moves an object with markers up and down by 1 cm. The offsets of the camera and of both
    fingertips from the arm's clock are estimated. If the bench lacks an arm, a gripper or the second
    fingertip, nothing moves: you press the object onto the gel and turn it to and fro by hand, and the
    offsets of the fingertips from the camera's clock are estimated.

    The folder of --from holds <name>.csv for both streams. The columns are time_ns (or t_s) and value, any
    quantity that changes with the motion. Long, fast and irregular motions give the best results. Instead of
    value the columns may be an orientation, qx, qy, qz, qw. Then the turning speeds are compared, which
    are equal for two sensors on one rigid body.

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
