"""Measure the run time of an estimator's stages."""

import time


class Stopwatch:
    """Run time of the stages of one frame, s; used only in reports, never in results."""

    def __init__(self) -> None:
        self.stage_s: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last lap to a stage."""
        now = time.perf_counter()
        self.stage_s[stage] = self.stage_s.get(stage, 0.0) + now - self._since
        self._since = now
