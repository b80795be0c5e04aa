"""Export a session as CSV or Parquet tables: lifts, angles, arm, gripper and frames, or poses and images.

Angles are in degrees, positive counter-clockwise as the external camera sees them, from the zero at
the end of phase A. `t_s` is the bench's monotonic time, `t_lift_s` counts from the beginning of phase
B. Quaternions are xyzw, poses `base_T_tcp` in m, forces in N and torques in N m in the base's axes.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import asdict

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from drivers.types import Pose
from protocols.observer import Phase
from rig.export.messages import lift_messages
from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.results.table import COLUMNS as LIFT_COLUMNS
from rig.results.table import session_cells, table_row
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import RecordedAngle, RecordedGripper, RecordedJoints, phase_times
from rig.sessions.records import IMAGE_COLUMNS, Lift, image_lines
from rig.sessions.table_files import Columns, Line, csv_bytes, parquet_bytes

WHEN: Columns = {
    "session": str, "number": int, "object": str, "name": str, "lift": int, "phase": str,
    "t_s": float, "t_lift_s": float,
}  # fmt: skip
ANGLE_COLUMNS: Columns = {
    **WHEN, "source": str, "angle_deg": float, "sigma_deg": float, "state": str, "contact_area_px": float,
}  # fmt: skip
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
JOINTS = tuple(f"joint{i}_rad" for i in range(1, 7))
WRENCH = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
ARM_COLUMNS: Columns = {**WHEN, **dict.fromkeys((*POSE, *JOINTS, *WRENCH), float), "mode": str}
GRIPPER_COLUMNS: Columns = {
    **WHEN, "opening_m": float, "current_a": float, "position_counts": int, "current_counts": int,
    "moving": bool,
}  # fmt: skip
FRAME_COLUMNS: Columns = {**WHEN, "source": str, "sequence": int}
POSE_COLUMNS: Columns = {
    "session": str, "pose": int, "attempt": int, "position": str, "orientation_deg": float,
    "accepted": bool, "fault": str, "rejected_frames": int, "images": int, "seed": int, "simulated": bool,
}  # fmt: skip
Tables = dict[str, tuple[Columns, list[Line]]]
"""Tables to export by name: their columns and rows."""


def export_csv(request: ExportRequest) -> Exported:
    """Write each table as CSV. Raises `SessionError` for a damaged recording."""
    return _export(request, "csv", csv_bytes)


def export_parquet(request: ExportRequest) -> Exported:
    """Write each table as Parquet. Raises `SessionError`, and `InputError` without pyarrow."""
    manifest = request.manifest
    about = {
        "session": request.session.name,
        "kind": manifest.kind,
        "started": manifest.started,
        "bench": manifest.bench,
        "simulated": simulated_mark(manifest).strip() or "no",
        "tool_version": manifest.tool_version,
        "conventions": " ".join((__doc__ or "").split("\n\n", 1)[-1].split()),
    }
    return _export(request, "parquet", lambda columns, lines: parquet_bytes(columns, lines, about))


def _export(request: ExportRequest, suffix: str, written: Callable[[Columns, list[Line]], bytes]) -> Exported:
    manifest, session = request.manifest, request.session.name
    if isinstance(manifest, TrialManifest):
        tables: Tables = _trial_tables(request, manifest)
    else:
        poses = [{"session": session, **vars(pose), "images": len(pose.images)} for pose in request.poses]
        images = [{"session": session, **line} for line in image_lines(request.accepted_poses)]
        tables = {
            "poses": (POSE_COLUMNS, poses),
            "images": ({"session": str, **IMAGE_COLUMNS}, images),
        }
    for name, table in tables.items():
        (request.out / f"{name}.{suffix}").write_bytes(written(*table))
    mark = simulated_mark(manifest).strip()
    return Exported({name: len(lines) for name, (_, lines) in tables.items()}, (mark,) if mark else ())


def _trial_tables(request: ExportRequest, manifest: TrialManifest) -> Tables:
    about = session_cells(request.session.name, manifest, manifest.estimator, manifest.window)
    lines: dict[type, list[Line]] = {kind: [] for kind in _TABLES}
    for row in request.finished_lifts:
        for kind, line in _lines_of(request, row):
            lines[kind].append(line)
    lifts = [table_row(about, lift, problem=lift.fault) for lift in request.lifts]
    others = {name: (columns, lines[kind]) for kind, (name, columns) in _TABLES.items()}
    return {"lifts": (LIFT_COLUMNS, lifts), **others}


_TABLES: dict[type, tuple[str, Columns]] = {
    RecordedAngle: ("angles", ANGLE_COLUMNS),
    RecordedJoints: ("arm", ARM_COLUMNS),
    RecordedGripper: ("gripper", GRIPPER_COLUMNS),
    bytes: ("frames", FRAME_COLUMNS),
}
"""Name and columns of the table of each kind of message."""


def _lines_of(request: ExportRequest, row: Lift) -> Iterator[tuple[type, Line]]:
    """Yield each message of a lift as a row of a table, with its kind."""
    path = request.session / row.recording
    phases = sorted((time_ns, phase) for phase, time_ns in phase_times(path).items())
    starts = [time_ns for time_ns, _ in phases]
    lift_ns = next(time_ns for time_ns, phase in phases if phase == Phase.LIFT)
    identity = {name: getattr(row, name) for name in ("number", "object", "name", "lift")}
    pose: tuple[float, ...] = ()
    for message in lift_messages(path):
        value, when = message.value, message.time_ns
        if isinstance(value, Pose):
            pose = (*value.position_m, *value.quaternion_xyzw)
        if value is None or isinstance(value, Pose):
            continue
        line: Line = {
            "session": request.session.name,
            **identity,
            "phase": phases[max(bisect_right(starts, when) - 1, 0)][1],
            "t_s": when / NS_PER_S,
            "t_lift_s": (when - lift_ns) / NS_PER_S,
            "source": message.source,
        }
        if isinstance(value, RecordedJoints):
            if not pose:
                raise SessionError(f"{path}: the recording is damaged (joints of the arm without its pose)")
            numbers = (*pose, *value.joints_rad, *(value.wrench or (None,) * len(WRENCH)))
            line |= {**dict(zip((*POSE, *JOINTS, *WRENCH), numbers, strict=True)), "mode": value.mode.value}
        else:
            line |= {"sequence": message.sequence} if isinstance(value, bytes) else asdict(value)
        yield type(value), line
