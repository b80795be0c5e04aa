"""Photographs of pressed balls in a folder, with or without a catalogue and hand-drawn circles."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.gel.balls import BALLS_MM, Press, find_press
from calibration.gel.look_fit import Circle, Pressed
from calibration.targets.boards import SAME_VIEW_PX
from calibration.verdict import Rejected, length_guess
from drivers.errors import InputError
from drivers.formats import number_in, read_csv_rows
from drivers.images import read_image
from drivers.types import Image
from rig.calibrate.samples import picture_files

Row = tuple[str, float, Path | None, tuple[float, float] | None]
"""Picture, ball diameter in mm, its own background, place of the ball in mm (x right, y down)."""


CIRCLE_COLUMNS = "center_x", "center_y", "radius"
"""Columns of circles.csv beside the name of the picture, px."""


@dataclass(slots=True)
class PressFolder:
    """The presses of a folder.

    folder: of the pictures. untouched: further frames without contact. found: presses in which a contact was
    detected. pressed: photographs with the circle of their contact, drawn by hand if there is such a circle,
    else detected. moves_mm: position of the ball by id, x right and y down.
    """

    folder: Path
    background: Image
    untouched: list[Image] = field(default_factory=list)
    found: list[Press] = field(default_factory=list)
    pressed: list[Pressed] = field(default_factory=list)
    rejected: list[Rejected] = field(default_factory=list)
    moves_mm: dict[str, tuple[float, float]] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)


def read_press_folder(
    folder: Path,
    ball_mm: float | None = None,
    background: Path | None = None,
    circles: Path | None = None,
    untouched: Path | None = None,
) -> PressFolder:
    """Read the presses of a folder, or of its folder `frames`, and find the contact in each.

    catalog.csv names pictures and ball diameters; with ball_mm every picture shows a press of that ball.
    background: by default background.png of the folder. circles: by default circles.csv of the folder, if
    there is one: frame (or image) and `CIRCLE_COLUMNS`. untouched: folder of frames without contact. A press
    whose centre and radius are within 2 px of another one with the same ball is rejected. Raises
    `InputError`.
    """
    still = background or folder / "background.png"
    drawn = circles or folder / "circles.csv"
    pictures = folder / "frames" if (folder / "frames").is_dir() else folder
    presses = PressFolder(pictures, read_image(still), files=[still])
    if untouched is not None:
        presses.untouched = [read_image(path) for path in picture_files(untouched)]
        if any(image.shape != presses.background.shape for image in presses.untouched):
            raise InputError(f"{untouched}: has pictures of another size than {still}: use one size")
    if ball_mm is None and not (folder / "catalog.csv").exists():
        raise InputError(f"{folder}: has no catalog.csv; give the diameter of the ball with --ball-mm")
    if ball_mm is None:
        presses.files.append(folder / "catalog.csv")
        rows = _catalogued(folder, folder / "catalog.csv")
    else:
        ball_mm = _diameter_mm(ball_mm, "--ball-mm")
        rows = [(p.name, ball_mm, None, None) for p in picture_files(pictures) if p.stem != "background"]
    by_hand = _circles(drawn) if circles or drawn.is_file() else {}
    if by_hand and by_hand.keys().isdisjoint(_key(Path(name).stem) for name, *_ in rows):
        raise InputError(f"{drawn}: names no picture of {pictures}")
    for name, diameter_mm, own_background, move_mm in rows:
        presses.files.append(pictures / name)
        rest = read_image(own_background) if own_background else presses.background
        image = read_image(pictures / name)
        found = find_press(image, rest.astype(np.float32), name, diameter_mm / 2.0)
        circle = by_hand.get(_key(Path(name).stem))
        if circle is None and not isinstance(found, str):
            circle = *found.centre_px, found.rim_px
        if circle is not None:
            # a copy of a picture, or of its row, would be in the fit while the other is held out
            same = [p for p in presses.pressed if 2.0 * p.radius_mm == diameter_mm]
            near = [p for p in same if np.abs(np.subtract(circle, p.circle)).max() < SAME_VIEW_PX]
            if near:
                presses.rejected.append(Rejected(name, f"same press as {near[0].id}"))
                continue
            (x, y, _), (rows_px, columns_px) = circle, image.shape[:2]
            if not (0.0 <= x < columns_px and 0.0 <= y < rows_px):
                size = f"{columns_px} x {rows_px} px"
                text = f"the centre of its circle, ({x:.0f}, {y:.0f}), is outside the picture of {size}"
                presses.rejected.append(Rejected(name, text))
                continue
        if isinstance(found, str):
            presses.rejected.append(Rejected(name, found))
        else:
            presses.found.append(found)
            if move_mm is not None:
                presses.moves_mm[name] = move_mm
        if circle is not None:
            presses.pressed.append(Pressed(name, image, circle, diameter_mm / 2.0))
    return presses


def read_circled(folder: Path) -> tuple[Image, list[tuple[Image, Circle]]]:
    """Return background.png of a folder of presses, and each picture with its circle of circles.csv.

    The pictures are those of the folder, or of its folder `frames`; pictures without a circle are left out.
    Raises `InputError`.
    """
    circles = _circles(folder / "circles.csv")
    pictures = picture_files(folder / "frames" if (folder / "frames").is_dir() else folder)
    found = [(read_image(path), circles[_key(path.stem)]) for path in pictures if _key(path.stem) in circles]
    if not found:
        raise InputError(f"{folder / 'circles.csv'}: names no picture of {folder}")
    return read_image(folder / "background.png"), found


def _catalogued(folder: Path, path: Path) -> list[Row]:
    rows: list[Row] = []
    for line, row in read_csv_rows(path, ("image", "diameter(mm)")):
        where, name = f"{path} line {line}", row["image"]
        if not name or not (folder / name).is_file():
            raise InputError(f"{where}: {name} is not in {folder}")
        own = folder / row["background"] if row.get("background") else None
        moved = row.get("x_mm") and row.get("y_mm")
        move = (number_in(row, "x_mm", where), number_in(row, "y_mm", where)) if moved else None
        rows.append((name, _diameter_mm(number_in(row, "diameter(mm)", where), where), own, move))
    return rows


def _diameter_mm(value: float, where: str) -> float:
    """Return a ball's diameter. Raises `InputError`, with a guess of the unit, unless it fits a gel."""
    low, high = BALLS_MM
    if not low <= value <= high:
        guess = length_guess(1e-3 * value, "mm", 1e-3 * low, 1e-3 * high)
        raise InputError(f"{where}: a ball of {value:g} mm; {low:g} to {high:g} mm fit a gel{guess}")
    return value


def _circles(path: Path) -> dict[str, Circle]:
    """Read circles by the name of their picture, without leading zeros."""
    found: dict[str, Circle] = {}
    for line, row in read_csv_rows(path, CIRCLE_COLUMNS):
        where = f"{path} line {line}"
        name = row.get("frame") or row.get("image")
        if not name:
            raise InputError(f"{where}: column frame (or image) names no picture")
        x, y, radius = (number_in(row, column, where) for column in CIRCLE_COLUMNS)
        if radius <= 0.0:
            raise InputError(f"{where}: a circle's radius is {radius:g} px; it must be positive")
        if _key(Path(name).stem) in found:
            raise InputError(f"{where}: {name} has a circle already: keep one")
        found[_key(Path(name).stem)] = x, y, radius
    return found


def _key(stem: str) -> str:
    return stem.lstrip("0") or "0"
