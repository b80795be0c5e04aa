"""Derive seeds from the task alone, independent of time and process (contract, session folder)."""

import hashlib


def derived_seed(seed: int, *what: str | int, attempt: int = 0) -> int:
    """Return a seed of 48 bits for a task, e.g. `derived_seed(0, "t1", 3)`.

    attempt: each further attempt, from 1, has a different seed.
    """
    text = "/".join(str(part) for part in (seed, *what, *([attempt] if attempt else [])))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
