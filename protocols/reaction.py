"""React to a slip during a lift: not at all, stop, tighten the grip, or set the object down."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.motion import Motion
from protocols.observer import LiftEvents, ReactionStep
from protocols.pump import Pump
from protocols.steps import MOTION_TIMEOUT_S, move_fingers

MOST_REACTIONS = 8
"""Most reactions in one lift. The last one ends the lift: an object that still slips is lifted no higher."""
FIRST_CLOSING_M = 0.0037
"""First closing of a lift, m: six steps of a Robotiq 3-Finger. Each further closing is twice as large, so
that a few of them reach any grip."""
REST_TIMEOUT_S = 0.5
"""If a closing has not brought the object to rest after this time, the next closing follows."""


class ReactionKind(StrEnum):
    """Reaction to a slip event. All but the first stop the arm."""

    NONE = "none"
    STOP = "stop"
    TIGHTEN = "tighten"
    LOWER = "lower"


class SlipSense(Protocol):
    """Detects slip from the fingertips. The object also receives the reaction steps as `LiftEvents`."""

    def slip_ns(self) -> int | None:
        """Return the capture time of the frame that showed a slip to react to now; None if there is none."""
        ...

    def at_rest(self) -> bool:
        """Whether no fingertip has detected rotation for a while."""
        ...

    def another_is_too_much(self) -> bool:
        """Whether one more slip, larger than those so far, would exceed the permitted rotation."""
        ...


@dataclass(frozen=True, slots=True)
class Reaction:
    """The selected reaction, and the slip detector.

    largest_grip_steps: for `TIGHTEN`, beyond first contact, in steps of the gripper's resolution.
    """

    kind: ReactionKind
    sense: SlipSense
    largest_grip_steps: int = 0


class Reflex:
    """Executes the reactions of one lift.

    contact_m: opening at which the fingers met the object. grip_steps: initial closing beyond it, in steps of
    the gripper's resolution.
    """

    def __init__(
        self, bench: Bench, pump: Pump, observer: LiftEvents, reaction: Reaction | None, contact_m: float,
        grip_steps: int,
    ) -> None:  # fmt: skip
        self._bench, self._pump, self._observer, self._reaction = bench, pump, observer, reaction
        spec = bench.gripper.spec
        contact = spec.step_at(contact_m)
        self._position = contact + grip_steps
        self._firmest = min(contact + (reaction.largest_grip_steps if reaction else 0), spec.steps)
        self._closing = spec.steps_for(FIRST_CLOSING_M)
        self._left = MOST_REACTIONS if reaction and reaction.kind is not ReactionKind.NONE else 0

    @property
    def sets_down(self) -> bool:
        """Whether the object is set down right after the reaction, without a hold phase."""
        reaction = self._reaction
        return reaction is not None and reaction.kind is ReactionKind.LOWER

    def has_slip(self) -> bool:
        """Whether there is a slip to react to."""
        return self._left > 0 and self._reaction is not None and self._reaction.sense.slip_ns() is not None

    def react(self, rising: Motion | None = None) -> bool:
        """Stop the arm and execute the reaction; return whether the lift continues.

        rising: the arm's motion, if any. Frames are delivered during the reaction.
        """
        self._left -= 1
        self._report(ReactionStep.STOP)
        self._bench.arm.stop()
        if rising is not None:
            self._pump.run_until(rising.is_done, MOTION_TIMEOUT_S, "the arm did not stop after a slip")
        self._report(ReactionStep.STANDS)
        caught = self._tighten() and self._left > 0
        self._report(ReactionStep.REST if caught else ReactionStep.ENDS)
        if not caught:
            self._left = 0
        return caught

    def _tighten(self) -> bool:
        """Close step by step until the object is at rest; return whether the lift may continue.

        At its largest grip the hand cannot tighten further, but the slip may have ended, or may have been a
        false detection. The lift then continues if one more slip is permissible, even if the object does not
        appear at rest, because angles are noisier in a firm grip.
        """
        if self._reaction is None or self._reaction.kind is not ReactionKind.TIGHTEN:
            return False
        while self._position < self._firmest:
            self._position = min(self._position + self._closing, self._firmest)
            self._report(ReactionStep.CLOSE)
            opening_m = self._bench.gripper.spec.opening_at(self._position)
            self._observer.gripper(move_fingers(self._bench, opening_m, self._pump))
            self._report(ReactionStep.CLOSED)
            self._closing *= 2
            if self._comes_to_rest(self._reaction.sense.at_rest):
                return True
        self._comes_to_rest(self._reaction.sense.at_rest)
        return not self._reaction.sense.another_is_too_much()

    def _comes_to_rest(self, at_rest: Callable[[], bool]) -> bool:
        end_ns = self._bench.clock.now_ns() + to_ns(REST_TIMEOUT_S)
        self._pump.run_until(
            lambda: at_rest() or self._bench.clock.now_ns() >= end_ns,
            MOTION_TIMEOUT_S,
            "the frames after a firmer grip were not processed",
        )
        return at_rest()

    def _report(self, step: ReactionStep) -> None:
        if self._reaction is not None:
            self._observer.reaction(step, self._bench.clock.now_ns(), self._position)
