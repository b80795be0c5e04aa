"""Estimate of the remaining time, which includes the finished fraction of work in progress."""

from drivers.clock import NS_PER_S, Clock, SystemClock

LEAST_WORK = 0.05
"""Least finished fraction of one piece of work for an estimate."""
MOST_IN_PROGRESS = 0.97
"""Largest finished fraction of work in progress."""
LEAST_S = 1.0
"""Least elapsed time for an estimate: the first report may contain several pieces at once."""
USUAL_PIECES = 10
"""Weight of the pace of an earlier run, in pieces: the first pieces of a run include its start."""


class TimeLeft:
    """The remaining time for `total` pieces of work, of which `done` were finished before the measurement.

    usual_s: time per piece in an earlier run, if known.
    """

    def __init__(
        self, total: int, done: int = 0, clock: Clock | None = None, usual_s: float | None = None
    ) -> None:
        self._clock = clock or SystemClock()
        self._before = done
        self._began_ns = self._clock.now_ns()
        self._newest_ns: int | None = None
        self._usual_s, self._usual_pieces = usual_s or 0.0, USUAL_PIECES if usual_s else 0
        self.total, self.done = total, done

    def begin(self) -> None:
        """Start the measurement of time."""
        self._began_ns = self._clock.now_ns()

    def seconds(self, shares: tuple[float, ...] = ()) -> float | None:
        """Return the remaining time, s; None until enough is done. shares: finished fractions in progress."""
        in_progress = sum(min(max(share, 0.0), MOST_IN_PROGRESS) for share in shares)
        worked = self.done - self._before + in_progress
        elapsed_s = (self._clock.now_ns() - self._began_ns) / NS_PER_S if worked else 0.0
        if not self._usual_pieces and (worked < LEAST_WORK or elapsed_s < LEAST_S):
            return None
        pace_s = (elapsed_s + self._usual_s * self._usual_pieces) / (worked + self._usual_pieces)
        return pace_s * max(self.total - self.done - in_progress, 0.0)

    def piece_done(self, done: int, total: int) -> None:
        """Count a finished piece, `done` in total. Time is measured from the end of the first, slower one.

        If fewer pieces are done than before, another part of the work has begun: its pace is measured again.
        """
        now_ns = self._clock.now_ns()
        if self._newest_ns is None or done < self.done:
            self._before, self._began_ns = done, now_ns
        self.done, self.total, self._newest_ns = done, total, now_ns

    def counting_down(self) -> float | None:
        """Return the remaining time at the usual pace, without the progress of the current piece."""
        done = self.done - self._before
        if self._newest_ns is None or done <= 0 or self._newest_ns <= self._began_ns:
            return None
        usual_ns = (self._newest_ns - self._began_ns) / done
        return self.seconds(((self._clock.now_ns() - self._newest_ns) / usual_ns,))


def left_text(seconds: float | None) -> str:
    """Return a remaining time as text: "about 1 min 20 s left", or "" if it is unknown."""
    if seconds is None:
        return ""
    whole = round(seconds)
    if whole < 60:
        return f"about {whole} s left"
    minutes, rest = divmod(whole, 60)
    return f"about {minutes} min {rest} s left" if minutes < 60 else f"about {whole / 3600:.1f} h left"
