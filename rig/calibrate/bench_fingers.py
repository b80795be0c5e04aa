"""The gripper on a bench: its opening over counts, from blocks of known width between the fingers."""

from collections.abc import Sequence

from drivers.errors import InputError, counted
from protocols.capture_touch import Touch, capture_openings
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions, write_table
from rig.calibrate.from_tables import gripper_from_folder
from rig.calibrate.result import CalibrationResult

_SLACK_M = 0.006
"""How much wider than a block the fingers come down around it, on top of the usual margin."""


def collect_openings(station: Station, blocks_mm: Sequence[float]) -> CalibrationResult:
    """Close on each block until both gels feel it, open until they do not, and make the tables.

    Raises `InputError` for blocks the fingers cannot take, `OperatorStopError`, `DeviceError`.
    """
    config = station.config
    widest_mm = 1e3 * config.gripper.limits.max_opening_m - 10.0
    if not blocks_mm or min(blocks_mm) < 3.0 or max(blocks_mm) > widest_mm:
        raise InputError(f"blocks of {list(blocks_mm)} mm: between the fingers fit 3 to {widest_mm:.0f} mm")
    raw = station.raw("gripper")
    open_counts = config.gripper.limits.min_counts
    rows: list[str] = []

    def note(touch: Touch, steps: float, direction: str) -> None:
        counts = open_counts + steps
        rows.append(f"{counts:g},{1e3 * touch.width_m:g},{direction}")
        station.note(f"{touch.name}: {counts:g} counts {direction}", len(rows), 2 * len(touches))

    touches = [
        Touch(
            f"{mm:g}", f"gauge:{mm:g}", f"block {mm:g} mm wide", grasp_at(config), mm / 1e3, slack_m=_SLACK_M
        )
        for mm in sorted(blocks_mm)
    ]
    with station.connected(
        f"The fingers will close gently on {counted(len(touches), 'block')}, one by one, until "
        "both gels feel them.",
        from_home=True,
        motions=touch_motions(config, touches),
    ) as (bench, operator):
        watch = TouchObserver(tuple(tip.sensor.serial for tip in bench.fingertips), shown=station.show)
        capture_openings(
            bench, operator, watch, touches,
            lambda touch, steps: note(touch, steps, "closing"),
            lambda touch, steps: note(touch, steps, "opening"),
        )  # fmt: skip
    write_table(raw / "gripper.csv", "counts,opening_mm,direction", rows)
    return gripper_from_folder(raw, config.name).marked(config.simulated)
