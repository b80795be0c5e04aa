"""Wall time of an estimator's stages."""

import time


class Stopwatch:
    """Wall time of the stages of one frame, s; for reports of cost only, never for results."""

    def __init__(self) -> None:
        self.stage_s: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap under a stage."""
        now = time.perf_counter()
        self.stage_s[stage] = self.stage_s.get(stage, 0.0) + now - self._since
        self._since = now
