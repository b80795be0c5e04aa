"""The records of a session, line by line: lifts, poses, and the durations of both.

Units are degrees, seconds, metres and pixels, as the names state; angles are positive counter-clockwise in
the external camera's view. The schema version is in the session's manifest (`manifest.py`). Any
change of a key requires a new version. Durations are in `timing.jsonl`, because everything else is the same
for the same seed.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import partial
from operator import attrgetter
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field
from pydantic_core import CoreSchema
from pydantic_core.core_schema import none_schema, plain_serializer_function_ser_schema

from drivers.clock import NS_PER_S
from drivers.errors import plural
from protocols.observer import Phase
from protocols.reaction import ReactionKind
from rig.config.fields import FileName, InnerPath
from rig.sessions.codec import Codec, strict
from rig.tactile.angles import FUSED, MARKERS, Angles, Floats
from rig.tactile.sample import EstimatorFaults, SlipSample, State, faults_of


class LiftOutcome(StrEnum):
    """How a lift ended. A fault is not a result for the object; all others are.

    caught: a reaction to slip kept the rotation within the limit, and the lift reached its full height; also
    if the rotation never reached half a degree.
    """

    SLIPPED = "slipped"
    HELD = "held"
    FALLEN = "fallen"
    CAUGHT = "caught"
    FAULT = "fault"


def _all_phases(phases_s: dict[str, float]) -> dict[str, float]:
    if missing := [phase.value for phase in Phase if phase not in phases_s]:
        raise ValueError(f"has no phase {', '.join(missing)}")
    if unknown := [name for name in phases_s if name not in set(Phase)]:
        raise ValueError(f"has the unknown phase {unknown[0]:.40}")
    return phases_s


Seconds = Annotated[float, Field(ge=-9e9, le=9e9)]
"""Outside this range, the difference in integer nanoseconds to other times does not fit 64 bits."""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Mean, standard deviation and maximum of |RE| in degrees over `frames` answered frames."""

    mean_deg: float
    std_deg: float
    max_deg: float
    frames: int


@dataclass(frozen=True, slots=True)
class MarkerDistance:
    """Two distances from the camera to an object in its place that should be equal, m.

    seen_m: from marker side and intrinsics. placed_m: from the poses of the camera and the table's mark.
    """

    seen_m: float
    placed_m: float

    def __str__(self) -> str:
        return f"the markers appear {self.seen_m:.3f} m away instead of {self.placed_m:.3f} m (camera's pose)"


@dataclass(frozen=True, slots=True)
class TurnsAgainst:
    """Fingertips whose angle turns against the true angle over a lift.

    serials: of these fingertips. exchanged: whether these are all, as if they were exchanged. estimate_deg,
    truth_deg: last angle of one of them, and true angle then.
    """

    serials: tuple[str, ...]
    exchanged: bool
    estimate_deg: float
    truth_deg: float

    def __str__(self) -> str:
        turned = f"turned {self.estimate_deg:+.1f} degrees, the markers {self.truth_deg:+.1f}"
        if self.exchanged:
            return f"the fingertips may be exchanged: the estimate {turned} (fingers in the bench file)"
        return f"the sign of {', '.join(self.serials)} may be wrong: the estimate {turned}"


MOST_LAG_S = 0.05
"""Largest lag without a warning: the camera's frames may be as far apart (contract), and an object that turns
by 40 degrees a second is 2 degrees further by then. 27 SIMULATED lifts, easy and hard, have at most 0.012."""
SURE = 3.0
"""A lag that is a reason for a warning exceeds 0 by more than this many of its standard deviations."""


@dataclass(frozen=True, slots=True)
class ClockLag:
    """By how much the estimate follows the true angle too late; negative if it is too early.

    sigma_s: one standard deviation.
    """

    lag_s: float
    sigma_s: float

    @property
    def large(self) -> bool:
        """Whether it is a reason for a warning."""
        return abs(self.lag_s) > max(MOST_LAG_S, SURE * self.sigma_s)

    def __str__(self) -> str:
        late = "after" if self.lag_s > 0.0 else "before"
        return (
            f"the estimate turns {abs(self.lag_s):.2f} +- {self.sigma_s:.2f} s {late} the markers (clocks of "
            "camera and fingertips)"
        )


@dataclass(frozen=True, slots=True)
class SlipThreshold:
    """Angle since rest, and rate, above which a fingertip reports a slip."""

    angle_deg: float
    rate_deg_s: float


@dataclass(frozen=True, slots=True)
class ReactionRecord:
    """A reaction to slip. Times since the start of phase B, s; rotations are true ones since the zero, deg.

    serial: of the fingertip that detected the slip. onset_s: when the object had rotated by 0.5 degrees since
    it was last at rest; None if it had not: a false alarm, or caught before. event_s: capture of the frame in
    which the slip was detected. serial and event_s are None if another estimator evaluates the lift and
    detects none. command_s: the arm was commanded to stop. standstill_s: of arm and fingers. rest_s: the
    object was detected at rest; None if the lift ended instead. counts_added: to the grip.
    """

    serial: str | None
    onset_s: float | None
    event_s: float | None
    command_s: float
    standstill_s: float
    rest_s: float | None
    counts_added: int
    onset_turn_deg: float | None
    event_turn_deg: float | None
    command_turn_deg: float | None
    standstill_turn_deg: float | None
    rest_turn_deg: float | None


NO_ANGLES = Angles(np.empty(0), np.empty(0))


IN_RESULTS, IN_CSV, IF_REACTING = "results", "always", "reacting"
"""Tables that have a column: those of many lifts; these and a session's `lifts.csv`; these and `lifts.csv` of
sessions with reactions to slip."""


class Column(NamedTuple):
    """A column of the tables with a row per lift; the suffix of its name is its unit."""

    name: str
    tables: str
    kind: type
    value: Callable[["Lift"], object]


class Shown(NamedTuple):
    """A column of the report's table of lifts. rank: its place. filter: as in `rig.report.parts.Table`."""

    rank: int
    heading: str
    text: Callable[["Lift"], str]
    filter: str = ""


def known_value(doc: str, tables: str = "", *shown: Shown, **default: Any) -> Any:
    """Declare a value of a lift that is known without its measurement; arguments as for `figure`."""
    return field(**default, metadata={"doc": doc, "tables": tables, "shown": shown})


def figure(
    doc: str,
    of: Callable[[Any], object],
    tables: str = "",
    *shown: Shown,
    columns: Sequence[Column] = (),
    optional: bool = False,
    **default: Any,
) -> Any:
    """Declare a measured value of a lift: its computation, the line of JSON, the tables, the report and CSV.

    Lifts that ended in a fault do not have it. doc: its meaning; the suffix of its name is its unit. of:
    computes it from a `rig.lift.result.MeasuredLift`, which this package must not import. tables:
    `IN_RESULTS`, `IN_CSV` or `IF_REACTING` for a column with the value, or with each number of an
    `ErrorSummary`. shown: columns of the report. columns: columns that are computed from the value. optional:
    whether the line leaves it out at its default. default: as for a dataclass field, by default None.
    """
    stored = {} if optional else {"stored": lambda lift: lift.accepted}
    about = {"doc": doc, "tables": tables, "shown": shown, "columns": columns, "figure": of, **stored}
    return field(**(default or {"default": None}), metadata=about)


def _tallies(measured: Any, key: str) -> dict[str, int]:
    return {name: getattr(tally, key) for name, tally in measured.measurement.tallies.items()}


def _count_states(samples: Iterable[SlipSample]) -> dict[str, int]:
    counts = Counter(sample.state for sample in samples)
    return {state.value: counts[state] for state in State if counts[state] or state is not State.FROZEN}


def _percentile_95(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, 95)) if known.size else None


def _signed_text(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "" if value is None else f"{value * factor:+z.{digits}f}"


def _first_reaction(key: str, lift: "Lift") -> object:
    return getattr(lift.reactions[0], key) if lift.reactions else None


_REACTIONS = (
    Column("reactions", IF_REACTING, int, lambda of: None if of.reactions is None else len(of.reactions)),
    Column("counts_added", IF_REACTING, int, lambda of: of.counts_added),
    *(
        Column(f"reaction_{key}", IF_REACTING, float, partial(_first_reaction, key))
        for key in ("onset_s", "event_s", "command_s", "standstill_s")
    ),
)
_WARNINGS = (
    Column("warnings", IN_CSV, str, lambda of: "; ".join(of.warnings) or None),
    Column("estimator_fault", IN_RESULTS, str, lambda of: of.estimator_faults and str(of.estimator_faults)),
)


class _NotStored:
    """Marks a field of a record that a line never has."""

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        return none_schema(serialization=plain_serializer_function_ser_schema(lambda value: None))


_UNSTORED = {"stored": lambda lift: False}
"""Metadata of a field that a line never has."""


@strict
@dataclass(frozen=True, kw_only=True)
class Lift:
    """One attempt at a lift: its plan, its course and, if it counts, its figures (contract, metrics).

    This is a line of `lifts.jsonl`. Until it has been carried out, it is a lift that ended in a fault. The
    order of the fields is that of the columns of tables.
    """

    number: int = known_value("number in the session, from 1; 0: session cannot be read", IN_CSV)
    attempt: int = known_value("repetition of the lift, from 0", IN_CSV)
    object: FileName = known_value("id of the object", IN_CSV)
    name: FileName = known_value("name of the object", IN_CSV)
    lift: int = known_value("number of the lift for its object, from 1", IN_CSV)
    position: str = known_value(
        "grasp position, as the object's file names it", IN_CSV, Shown(2, "grasp", lambda of: of.position)
    )
    accepted: bool = known_value("whether the lift counts", IN_CSV)
    outcome: LiftOutcome = known_value(
        "how the lift ended", IN_CSV, Shown(1, "outcome", lambda of: of.outcome.value, "choose")
    )
    fault: str | None = known_value(
        "fault that ended the lift: the error's text, and the bench's state afterwards", IN_CSV, default=None
    )
    grip_counts: int = known_value(
        "grip beyond first contact, in steps of the gripper", IN_CSV,
        Shown(3, "grip", lambda of: str(of.grip_counts)),
    )  # fmt: skip
    lift_height_m: float = known_value("height of the lift", IN_CSV)
    final_estimate_deg: float | None = figure(
        "mean estimate over the last 0.3 s of phase C", lambda m: m.final_deg(m.fused), IN_CSV
    )
    final_truth_deg: float | None = figure(
        "mean true angle over the last 0.3 s of phase C", lambda m: m.final_deg(m.truth), IN_CSV,
        Shown(6, "true turn, °", lambda of: _signed_text(of.final_truth_deg, 1)),
    )  # fmt: skip
    onset_truth_s: float | None = figure(
        "true onset of slip, since the start of phase B", lambda m: m.since_lift_s(m.onset_ns), IN_CSV
    )
    onset_estimate_s: float | None = figure(
        "onset found afterwards in the estimate", lambda m: m.since_lift_s(m.estimated_onset_ns), IN_CSV,
        Shown(8, "onset seen, ms later", lambda of: _signed_text(of.onset_delay_s, 0, 1e3)),
    )  # fmt: skip
    onset_alarm_s: float | None = figure(
        "onset reported during the lift", lambda m: m.since_lift_s(m.measurement.angle.alarm_ns), IN_RESULTS
    )
    answered: float = figure(
        "share of frames with an angle", lambda m: m.score.answered, IN_CSV,
        Shown(7, "answered", lambda of: f"{of.answered:.0%}"), default=0.0,
    )  # fmt: skip
    bench_s: float = known_value("duration by the bench's clock", IN_CSV)
    recording: InnerPath = known_value("recording in the session's folder", IN_CSV)
    re_b: ErrorSummary | None = figure("absolute error over phase B", lambda m: m.score.re_b, IN_CSV)
    re: ErrorSummary | None = figure(
        "absolute error over phases B and C; without an answer there is none", lambda m: m.score.re, IN_CSV,
        Shown(4, "mean error, °", lambda of: f"{of.re.mean_deg:.2f}" if of.re else "no answer", "least"),
        Shown(5, "largest, °", lambda of: f"{of.re.max_deg:.1f}" if of.re else ""),
    )  # fmt: skip
    re_held: ErrorSummary | None = figure(
        "absolute error with refused frames held at the last answer", lambda m: m.score.re_held, IN_CSV
    )
    sigma_b_p95_deg: float | None = figure(
        "95th percentile over phase B of the sigma of the estimate; without a sigma there is none",
        lambda m: _percentile_95(m.in_b.sigma_deg), IN_CSV,
        Shown(9, "sigma, °", lambda of: "" if of.sigma_b_p95_deg is None else f"{of.sigma_b_p95_deg:.2f}"),
        optional=True,
    )  # fmt: skip
    react: ReactionKind = known_value("configured reaction to slip", IF_REACTING, default=ReactionKind.NONE)
    reactions: tuple[ReactionRecord, ...] | None = figure(
        "reactions, only in lifts with reactions to slip", lambda m: m.reactions,
        columns=_REACTIONS, optional=True,
    )  # fmt: skip
    estimator_faults: EstimatorFaults | None = figure(
        "failures of a user-defined estimator", lambda m: faults_of(m.measurement.angle.samples),
        columns=_WARNINGS, optional=True,
    )  # fmt: skip
    speed_fraction: float | None = known_value(
        "position of the arm's speed slider, 0 to 1; None if unknown", IN_CSV, default=None
    )
    seed: int = known_value("seed of the plan and of a simulated lift")
    simulated: bool = known_value("whether the bench was simulated", IN_RESULTS)
    contact_area_px: dict[str, float] = figure(
        "contact area at the end of phase A by serial",
        lambda m: {n: float(np.mean(px)) if px.size else 0.0 for n, px in m.rest_areas_px.items()},
        default_factory=dict,
    )
    phases_s: Annotated[dict[str, Seconds], AfterValidator(_all_phases)] = figure(
        "start of each phase by the bench's clock",
        lambda m: {phase.value: time_ns / NS_PER_S for phase, time_ns in m.measurement.phases.items()},
        default_factory=dict,
    )
    frames: dict[str, int] = figure(
        'frames by serial, "camera" for the camera', lambda m: _tallies(m, "frames"), default_factory=dict
    )
    dropped: dict[str, int] = figure(
        "dropped frames, likewise", lambda m: _tallies(m, "dropped"), default_factory=dict
    )
    states: dict[str, int] = figure(
        "tactile frames by state", lambda m: _count_states(m.measurement.angle.samples), default_factory=dict
    )
    skipped: dict[str, int] = figure(
        "tactile frames by skipped stage",
        lambda m: dict(Counter(stage for of in m.measurement.angle.samples for stage in of.skipped)),
        default_factory=dict,
    )
    disagreements: dict[str, int] = figure(
        "tactile frames by kind of disagreement between the fingertips", lambda m: m.disagreements,
        default_factory=dict,
    )  # fmt: skip
    marker_distance: MarkerDistance | None = figure(
        "only as a warning", lambda m: m.marker_distance, optional=True
    )
    turns_against: TurnsAgainst | None = figure("only as a warning", lambda m: m.turns_against, optional=True)
    lag: ClockLag | None = figure(
        "delay of the estimate after the true angle; missing if it cannot be determined",
        lambda m: m.lag,
        columns=(Column("lag_s", IN_CSV, float, lambda of: of.lag and of.lag.lag_s),),
        optional=True,
    )
    jumped: dict[str, int] | None = figure(
        "frames left out for an invalid time, by source",
        lambda m: {name: count for name, count in _tallies(m, "jumped").items() if count} or None,
        optional=True,
    )
    slip_thresholds: dict[str, SlipThreshold] | None = figure(
        "by serial, with reactions to slip",
        lambda m: m.measurement.watch and m.measurement.watch.thresholds(),
        optional=True,
    )
    angles: Annotated[dict[str, Angles] | None, _NotStored()] = field(
        default=None, compare=False, metadata=_UNSTORED
    )
    """The angles over time by source, once `rig.sessions.reading.read_angles` or a table has given them."""
    notes: Annotated[tuple[str, ...], _NotStored()] = field(default=(), compare=False, metadata=_UNSTORED)
    """Damaged parts of the recording, which the angles leave out, or wrapped angles of a table."""
    frame_ms: Annotated[float | None, _NotStored()] = field(default=None, compare=False, metadata=_UNSTORED)
    """Median wall time per tactile frame with contact, if read from the session's timing or replayed."""

    @property
    def zero_ns(self) -> int:
        """Start of phase B by the recording's clock."""
        return round(self.phases_s[Phase.LIFT] * NS_PER_S)

    @property
    def estimate(self) -> Angles:
        """The fused angle over time; without angles it is empty, as the others are."""
        return (self.angles or {}).get(FUSED, NO_ANGLES)

    @property
    def truth(self) -> Angles:
        """The marker angle over time."""
        return (self.angles or {}).get(MARKERS, NO_ANGLES)

    @property
    def tips(self) -> dict[str, Angles]:
        """The angle of each fingertip over time, by serial."""
        return {name: of for name, of in (self.angles or {}).items() if name not in (FUSED, MARKERS)}

    @property
    def begins_s(self) -> dict[str, float]:
        """Start of each phase at the time axis of the angles, s; empty if unknown."""
        return {name: t - self.estimate.zero_ns / NS_PER_S for name, t in self.phases_s.items()}

    @property
    def error_deg(self) -> Floats:
        """Estimate minus truth at each frame of the estimate, (N,) deg; NaN if either is missing."""
        return self.estimate.angle_deg - self.truth.at(self.estimate.time_s)

    def errors(self, *phases: str) -> Floats:
        """Return the known absolute errors in some phases, by default in all frames, (M,) deg."""
        errors = np.abs(self.error_deg[self.within(*phases)] if phases else self.error_deg)
        return errors[np.isfinite(errors)]

    def within(self, *phases: str) -> NDArray[np.bool_]:
        """Return which frames of the estimate, (N,) bool, are in these phases; all if phases are unknown."""
        times, begins_s = self.estimate.time_s, self.begins_s
        inside = np.full(times.shape, not begins_s)
        for begins in (begins_s[phase] for phase in phases if phase in begins_s):
            ends = min((t for t in begins_s.values() if t > begins), default=np.inf)
            inside |= (times >= begins) & (times < ends)
        return inside

    @property
    def label(self) -> str:
        return f"{self.object} {self.name}"

    @property
    def title(self) -> str:
        """Name for display, such as "wrench, lift 3"; without a number, only the name."""
        return f"{self.name}, lift {self.lift}" if self.lift else self.name

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons to doubt the figures of the lift, for a person."""
        frozen = self.states.get("frozen", 0)
        repeats = f"a fingertip repeats its picture in {plural(frozen, 'frame')}: check its cable"
        found = (
            repeats if frozen else None,
            self.turns_against,
            self.lag if self.lag and self.lag.large else None,
            self.marker_distance,
            self.estimator_faults,
        )
        return tuple(str(what) for what in found if what)

    @property
    def displaced(self) -> bool:
        """Whether the object may lie anywhere afterwards."""
        return self.outcome in (LiftOutcome.FALLEN, LiftOutcome.FAULT)

    @property
    def slip_start_s(self) -> float | None:
        """The true start of the slip since the start of phase B, s; None without one.

        After a reaction the rotation may not grow for as long as `onset_truth_s` requires. Then the slip
        starts at the first reaction's `onset_s`.
        """
        starts = [self.onset_truth_s, *(reaction.onset_s for reaction in self.reactions or ())]
        return min((start for start in starts if start is not None), default=None)

    @property
    def onset_delay_s(self) -> float | None:
        """The delay of the estimated onset after that of the markers, s; None if either is missing."""
        seen, true = self.onset_estimate_s, self.onset_truth_s
        return None if seen is None or true is None else seen - true

    @property
    def counts_added(self) -> int | None:
        """The steps that reactions added to the grip; None for a lift without reactions to slip."""
        return None if self.reactions is None else sum(of.counts_added for of in self.reactions)


FIGURES = ("outcome", *(of.name for of in fields(Lift) if "figure" in of.metadata))
"""Names of the measured values of a lift."""
SHOWN = tuple(sorted(shown for of in fields(Lift) for shown in of.metadata.get("shown", ())))
"""Columns of the report's table of lifts."""


def lift_columns() -> Iterator[Column]:
    """Yield the columns of the tables with a row per lift, in order."""
    hints = get_type_hints(Lift)
    for of in fields(Lift):
        kind = next(k for k in (get_args(hints[of.name]) or (hints[of.name],)) if k is not type(None))
        tables = of.metadata.get("tables", "")
        if kind is ErrorSummary:
            for part in ("mean_deg", "std_deg", "max_deg"):
                yield Column(f"{of.name}_{part}", tables, float, partial(_error_part, of.name, part))
            yield Column(f"{of.name}_frames", IN_RESULTS, int, partial(_error_part, of.name, "frames"))
        elif tables:
            plain = next(k for k in (bool, int, float, str) if issubclass(kind, k))
            yield Column(of.name, tables, plain, attrgetter(of.name))
        yield from of.metadata.get("columns", ())


def _error_part(name: str, part: str, lift: Lift) -> object:
    return getattr(getattr(lift, name), part, None)


@dataclass(frozen=True, kw_only=True)
class PoseImage:
    """An image of a recording. file: in the session. contact_area_px: from the classical contact finder.

    grip_counts: steps beyond first contact; None in a recording by hand, in which it is not measured.
    """

    file: InnerPath
    grip_counts: int | None
    serial: FileName
    time_s: float
    contact_area_px: float


@strict
@dataclass(frozen=True, kw_only=True)
class PoseRow:
    """A line of `poses.jsonl`: an attempt at a grasp pose. fault: why it does not count, or None."""

    pose: int
    attempt: int
    position: str
    orientation_deg: float
    accepted: bool
    fault: str | None
    rejected_frames: int
    images: tuple[PoseImage, ...]
    seed: int
    simulated: bool

    @property
    def number(self) -> int:
        return self.pose

    @property
    def displaced(self) -> bool:
        """Whether the object may lie anywhere afterwards."""
        return self.fault is not None


IMAGE_COLUMNS = {
    "file": str, "pose": int, "position": str, "orientation_deg": float, "grip_counts": int, "serial": str,
    "time_s": float, "contact_area_px": float,
}  # fmt: skip
"""Columns of tables of images, with their types."""


def image_lines(poses: Iterable[PoseRow]) -> Iterator[dict[str, object]]:
    """Yield the values of each image of some poses, by column."""
    return ({**vars(pose), **vars(image)} for pose in poses for image in pose.images)


class _LiftCodec(Codec[Lift]):
    """Reads lifts. A lift that counts has all figures that are not optional; any other lift has none."""

    def parse(self, text: bytes) -> Lift:
        """Return the lift of a JSON text. Raises `ValueError` naming the invalid key."""
        lift, keys = super().parse(text), json.loads(text).keys()
        needed = [of.name for of in fields(Lift) if {"stored", "figure"} <= of.metadata.keys()]
        if lift.accepted and (missing := [name for name in needed if name not in keys]):
            raise ValueError(f"'{missing[0]}' is missing")
        if lift.accepted == (lift.outcome is LiftOutcome.FAULT) or lift.accepted != (lift.fault is None):
            raise ValueError(f"'outcome' {lift.outcome} contradicts 'accepted' or 'fault'")
        if not lift.accepted and (more := [name for name in FIGURES[1:] if name in keys]):
            raise ValueError(f"'{more[0]}' is a key that a lift without result does not have")
        return lift


@dataclass(frozen=True, slots=True)
class StageTimes:
    """Percentiles of a stage's computing time per frame, ms."""

    p50_ms: float
    p95_ms: float
    p99_ms: float


@dataclass(frozen=True, slots=True)
class LatencyTimes(StageTimes):
    """Percentiles and maximum of the time from a frame's capture to its logged angle, ms."""

    max_ms: float


@strict
@dataclass(frozen=True, kw_only=True)
class LiftTiming:
    """A trial's line of `timing.jsonl`. capture_to_angle: by serial, only on benches in real time."""

    number: int
    attempt: int
    wall_s: float
    stages: dict[str, StageTimes]
    capture_to_angle: dict[str, LatencyTimes] | None = None


@strict
@dataclass(frozen=True, kw_only=True)
class PoseTiming:
    """A recording's line of `timing.jsonl`."""

    pose: int
    attempt: int
    wall_s: float


@strict
@dataclass(frozen=True, kw_only=True)
class ReplayTiming:
    """A replay's line of `timing.jsonl`, in the order in which lifts finished."""

    session: str
    number: int | None


TimingLine = LiftTiming | PoseTiming | ReplayTiming


LIFTS: Codec[Lift] = _LiftCodec(Lift)
POSES: Codec[PoseRow] = Codec(PoseRow)
LIFT_TIMINGS: Codec[LiftTiming] = Codec(LiftTiming)


def accepted_lifts(lifts: Iterable[Lift]) -> list[Lift]:
    return [lift for lift in lifts if lift.accepted]


def lift_of_table(**values: Any) -> Lift:
    """Return an accepted lift of which a table contains only some values; the others are 0 or empty."""
    unknown = dict.fromkeys(("number", "attempt", "lift", "grip_counts", "seed"), 0)
    texts = dict.fromkeys(("object", "name", "position", "recording"), "")
    other = {"lift_height_m": 0.0, "bench_s": 0.0, "simulated": False, "accepted": True}
    return Lift(**{**unknown, **texts, **other, "outcome": LiftOutcome.HELD, **values})


def totals(lifts: Iterable[Lift], name: str) -> Counter[str]:
    """Return the sums over lifts of a figure that has a number per key, such as "frames"."""
    found = Counter[str]()
    for lift in lifts:
        found.update(getattr(lift, name) or {})
    return found
