"""What every training leaves in its folder, and how it says how far it is."""

from collections.abc import Callable
from pathlib import Path

from drivers.errors import InputError

CARD, MODEL = "card.json", "model.onnx"

Tell = Callable[[str, float], None]
"""Is told how far a training is: a text, and the share done of what it names."""


def claim(out: Path) -> None:
    """Make the folder before anything is learnt for it. Raises `InputError` for one that holds something."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        taken = any(out.iterdir())
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}): give another --out") from error
    if taken:
        raise InputError(f"{out} is not empty: give another --out")
