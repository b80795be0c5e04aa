"""When an answer is confidently wrong: one definition for all benchmarks."""

WRONG_DEG, WRONG_SIGMAS = 10.0, 3.0


def is_confidently_wrong(error_deg: float, sigma_deg: float | None) -> bool:
    """Return whether an answer is more than 10 degrees and more than 3 sigma off.

    error_deg: of either sign. sigma_deg: one standard deviation; an answer with None claims no confidence, so
    it is never confidently wrong.
    """
    return sigma_deg is not None and abs(error_deg) > max(WRONG_DEG, WRONG_SIGMAS * sigma_deg)
