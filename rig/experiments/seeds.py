"""Seeds that depend on what is done, never on when or by which process (contract, session folder)."""

import hashlib


def derived_seed(seed: int, *what: str | int, attempt: int = 0) -> int:
    """Return a seed of 48 bits for a piece of work, e.g. `derived_seed(0, "t1", 3)`.

    attempt: further ones, from 1, have seeds of their own.
    """
    text = "/".join(str(part) for part in (seed, *what, *([attempt] if attempt else [])))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
