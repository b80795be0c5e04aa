"""Seeds that depend on what is done, never on when or by which process (contract, session folder)."""

import hashlib


def derived_seed(seed: int, *what: str | int) -> int:
    """Return a seed of 48 bits for a piece of work, e.g. `derived_seed(0, "t1", 3)`."""
    text = "/".join(str(part) for part in (seed, *what))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")
