"""The looks of real units in which simulated gels are drawn."""

from functools import cache
from pathlib import Path

from calibration.gel.look import GelLook, load_look
from drivers.errors import CalibrationError
from rig.config import TactileConfig


def look_of(tactile: TactileConfig) -> GelLook | None:
    """Return the look that a bench file names for a sensor; None if it names none.

    Raises `CalibrationError` for a file that cannot be read, or is of another image size.
    """
    if tactile.look is None:
        return None
    look = _look(tactile.look, tactile.look_seed)
    if look.shape[::-1] != tactile.size_px:
        raise CalibrationError(
            f"{tactile.look}: was made of pictures of {look.shape[::-1]} px, the bench file has size_px = "
            f"{list(tactile.size_px)}; correct it"
        )
    return look


@cache
def _look(path: str, seed: int | None) -> GelLook:
    look = load_look(Path(path))
    return look if seed is None else look.varied(seed)
