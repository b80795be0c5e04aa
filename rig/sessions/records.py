"""What a session keeps, line by line: lifts, poses, replayed lifts.

Degrees, seconds, metres and pixels as the names say; angles are positive counter-clockwise as the
external camera sees them. The schema version stands in the session's manifest (`manifest.py`). A new key
comes with a default, so that sessions without it are read; a key that is no longer written is still read
and ignored (`InitVar`); any other change is a new version.
"""

from collections.abc import Iterable
from dataclasses import InitVar, dataclass
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from protocols.observer import REQUIRED
from protocols.reaction import ReactionKind
from rig.config.fields import FileName, InnerPath
from rig.sessions.codec import Codec, strict
from rig.tactile.foreign import EstimatorFaults


class LiftOutcome(StrEnum):
    """How a lift ended. A fault is no result for the object; all others are results.

    caught: a reaction to slip kept the turn within the limit, and it came to full height; also where the turn
    never became half a degree.
    """

    SLIPPED = "slipped"
    HELD = "held"
    FALLEN = "fallen"
    CAUGHT = "caught"
    FAULT = "fault"


def _all_phases(phases_s: dict[str, float]) -> dict[str, float]:
    missing = [phase.value for phase in REQUIRED if phase not in phases_s]
    if missing:
        raise ValueError(f"has no phase {', '.join(missing)}")
    return phases_s


Seconds = Annotated[float, Field(ge=-9e9, le=9e9)]
"""Integer nanoseconds of other times do not fit 64 bits."""
PhaseName = Annotated[str, Field(min_length=1, max_length=40)]
"""Of `protocols.observer.Phase`, or of a version of the rig that has more phases."""


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

    seen_m: by marker side and intrinsics. placed_m: by where the camera and the table's mark are.
    """

    seen_m: float
    placed_m: float

    def __str__(self) -> str:
        return f"the markers look {self.seen_m:.3f} m away, the camera's place says {self.placed_m:.3f} m"


@dataclass(frozen=True, slots=True)
class SlipThreshold:
    """Angle since rest, and rate, above which a fingertip reports a slip."""

    angle_deg: float
    rate_deg_s: float


@dataclass(frozen=True, slots=True)
class ReactionRecord:
    """A reaction to slip. Times since the start of phase B, s; turns are true ones since the zero, deg.

    serial: of the fingertip that told. onset_s: when the object had turned 0.5 degrees since it was last at
    rest, None where it had not: a false alarm, or caught before. event_s: capture of the frame that told
    of the slip; serial and event_s are None where another estimator looks at the lift and sees none.
    command_s: the arm was told to stop. standstill_s: of arm and fingers. rest_s: the object was seen at
    rest, None where the lift ended instead. counts_added: to the grip.
    votes: a key of sessions of version 1.0, which is read and ignored.
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
    votes: InitVar[dict[str, float] | None] = None

    def __post_init__(self, votes: dict[str, float] | None) -> None:
        """Ignore the key that is no longer written."""


@strict
@dataclass(frozen=True, kw_only=True)
class LiftHead:
    """Identity of a lift, and its parameters.

    number: in the session, from 1. lift: of its object, from 1. attempt: from 0. position: as the object's
    file names it. grip_counts: beyond first contact. recording: file in the session. react: what was to be
    done about slip. force_n: a key of sessions of version 1.0, which is read and ignored.
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
    force_n: InitVar[float | None] = None

    def __post_init__(self, force_n: float | None) -> None:
        """Ignore the key that is no longer written."""


@dataclass(frozen=True, kw_only=True)
class LiftFigures:
    """What was measured in a lift that reached its end (contract, metrics).

    re, re_b, re_held: errors over phases B and C, over B, and over B and C with refused frames held; None
    without an answer. contact_area_px: by serial. onset_truth_s, onset_estimate_s, onset_alarm_s: since the
    start of phase B, None where nothing began. phases_s: when each began, by the bench's clock. frames,
    dropped: by serial, "camera" for the camera's. states, skipped, disagreements: tactile frames by what
    the estimator said, by the stage it left out, by how the fingertips disagreed. marker_distance: there
    only where it warns. jumped: frames left out because their times cannot be, by source, where there are.
    reactions, slip_thresholds (by serial): there only in lifts that react to slip.
    estimator_faults: where an estimator that is not the rig's own failed on frames.
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
    phases_s: Annotated[dict[PhaseName, Seconds], AfterValidator(_all_phases)]
    frames: dict[str, int]
    dropped: dict[str, int]
    states: dict[str, int]
    skipped: dict[str, int]
    disagreements: dict[str, int]
    marker_distance: MarkerDistance | None = None
    jumped: dict[str, int] | None = None
    reactions: tuple[ReactionRecord, ...] | None = None
    slip_thresholds: dict[str, SlipThreshold] | None = None
    estimator_faults: EstimatorFaults | None = None


@dataclass(frozen=True, kw_only=True)
class FinishedLift(LiftHead, LiftFigures):
    """A lift that counts. bench_s: how long it took by the bench's clock.

    speed_fraction: at which share of their speed motions ran (the speed slider), None where not known.
    """

    accepted: Literal[True]
    bench_s: float
    speed_fraction: float | None = None


@dataclass(frozen=True, kw_only=True)
class FailedLift(LiftHead):
    """An attempt that a rig fault ended. fault: the error's text, and how the bench was left."""

    accepted: Literal[False]
    outcome: Literal[LiftOutcome.FAULT]
    fault: str
    bench_s: float
    speed_fraction: float | None = None


LiftRow = FinishedLift | FailedLift
"""A line of `lifts.jsonl`."""


@dataclass(frozen=True, kw_only=True)
class PoseImage:
    """An image of a recording. file: in the session. contact_area_px: as the classical finder saw it.

    grip_counts: steps past first contact; None in a recording by hand, where nobody measures it.
    """

    file: InnerPath
    grip_counts: int | None
    serial: FileName
    time_s: float
    contact_area_px: float


@strict
@dataclass(frozen=True, kw_only=True)
class PoseRow:
    """A line of `poses.jsonl`: an attempt at a grasp pose. fault: why it does not count, else None.

    force_n: a key of sessions of version 1.0, which is read and ignored.
    """

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
    force_n: InitVar[float | None] = None

    def __post_init__(self, force_n: float | None) -> None:
        """Ignore the key that is no longer written."""


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
