"""The records of a session, line by line: lifts, poses, replayed lifts.

Units are degrees, seconds, metres and pixels, as the names state; angles are positive counter-clockwise in
the external camera's view. The schema version is in the session's manifest (`manifest.py`). Any
change of a key requires a new version.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from drivers.errors import counted
from protocols.observer import Phase
from protocols.reaction import ReactionKind
from rig.config.fields import FileName, InnerPath
from rig.sessions.codec import Codec, strict
from rig.tactile.sample import EstimatorFaults


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


@dataclass(frozen=True, slots=True)
class ClockLag:
    """By how much the estimate follows the true angle too late; negative if it is too early.

    sigma_s: one standard deviation.
    """

    lag_s: float
    sigma_s: float

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


@strict
@dataclass(frozen=True, kw_only=True)
class LiftHead:
    """Identity of a lift, and its parameters.

    number: in the session, from 1. lift: of its object, from 1. attempt: from 0. position: its name in the
    object file. grip_counts: beyond first contact. recording: file in the session. react: the configured
    reaction to slip.
    """

    number: int
    attempt: int
    object: FileName
    name: FileName
    lift: int
    position: str
    grip_counts: int
    lift_height_m: float
    seed: int
    simulated: bool
    recording: InnerPath
    react: ReactionKind = ReactionKind.NONE


@dataclass(frozen=True, kw_only=True)
class LiftFigures:
    """The measured values of a lift that reached its end (contract, metrics).

    re, re_b, re_held: errors over phases B and C, over B, and over B and C with refused frames held at the
    last answer; None without an answer. contact_area_px: by serial. onset_truth_s, onset_estimate_s,
    onset_alarm_s: since the start of phase B, None without an onset. phases_s: start of each phase by the
    bench's clock. frames, dropped: by serial, "camera" for the camera. states, skipped, disagreements: number
    of tactile frames by state, by skipped stage, and by kind of disagreement between the fingertips.
    marker_distance, turns_against, lag: only if they are warnings. jumped: frames left out because of an
    invalid time, by source; only if there are any. reactions, slip_thresholds (by serial): only in lifts with
    reactions to slip. estimator_faults: failures of a user-defined estimator.
    """

    outcome: LiftOutcome
    re_b: ErrorSummary | None
    re: ErrorSummary | None
    re_held: ErrorSummary | None
    contact_area_px: dict[str, float]
    answered: float
    final_estimate_deg: float | None
    final_truth_deg: float | None
    onset_truth_s: float | None
    onset_estimate_s: float | None
    onset_alarm_s: float | None
    phases_s: Annotated[dict[str, Seconds], AfterValidator(_all_phases)]
    frames: dict[str, int]
    dropped: dict[str, int]
    states: dict[str, int]
    skipped: dict[str, int]
    disagreements: dict[str, int]
    marker_distance: MarkerDistance | None = None
    turns_against: TurnsAgainst | None = None
    lag: ClockLag | None = None
    jumped: dict[str, int] | None = None
    reactions: tuple[ReactionRecord, ...] | None = None
    slip_thresholds: dict[str, SlipThreshold] | None = None
    estimator_faults: EstimatorFaults | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons to doubt the figures of the lift, for a person."""
        frozen = self.states.get("frozen", 0)
        repeats = f"a fingertip repeats its picture in {counted(frozen, 'frame')}: check its cable"
        found = (
            repeats if frozen else None,
            self.turns_against,
            self.lag,
            self.marker_distance,
            self.estimator_faults,
        )
        return tuple(str(what) for what in found if what)

    @property
    def slip_start_s(self) -> float | None:
        """The true start of the slip since the start of phase B, s; None without one.

        After a reaction the rotation may not grow for as long as `onset_truth_s` requires. Then the slip
        starts at the first reaction's `onset_s`.
        """
        starts = [self.onset_truth_s, *(reaction.onset_s for reaction in self.reactions or ())]
        return min((start for start in starts if start is not None), default=None)


@dataclass(frozen=True, kw_only=True)
class FinishedLift(LiftHead, LiftFigures):
    """A lift that counts. bench_s: its duration by the bench's clock.

    speed_fraction: fraction of their speed at which motions ran (the speed slider), None if unknown.
    clock_rates: of sources whose time stamps advance at another speed than the bench's clock, by name: their
    speed divided by that of the clock; only if there are any.
    """

    accepted: Literal[True]
    bench_s: float
    speed_fraction: float | None = None
    clock_rates: dict[str, float] | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons to doubt the figures of the lift, for a person."""
        rates = [f"{name} at {rate:.2f}" for name, rate in (self.clock_rates or {}).items()]
        text = f"time stamps at another speed than this computer's clock: {', '.join(rates)}"
        return (*((text,) if rates else ()), *super().warnings)


@dataclass(frozen=True, kw_only=True)
class FailedLift(LiftHead):
    """An attempt that ended in a rig fault. fault: the error's text, and the bench's state afterwards."""

    accepted: Literal[False]
    outcome: Literal[LiftOutcome.FAULT]
    fault: str
    bench_s: float
    speed_fraction: float | None = None


LiftRow = FinishedLift | FailedLift
"""A line of `lifts.jsonl`."""


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


def _member(values: object) -> str:
    """Return the union member of a line; a line without `accepted` counts as a finished lift."""
    accepted = values.get("accepted", True) if isinstance(values, dict) else True
    return "finished" if accepted is True else "failed"


_LIFT = Annotated[
    Annotated[FinishedLift, Tag("finished")] | Annotated[FailedLift, Tag("failed")], Discriminator(_member)
]
LIFTS: Codec[LiftRow] = Codec(_LIFT)
POSES: Codec[PoseRow] = Codec(PoseRow)


def finished(rows: Iterable[LiftRow]) -> list[FinishedLift]:
    """Return the lifts that count."""
    return [row for row in rows if isinstance(row, FinishedLift)]
