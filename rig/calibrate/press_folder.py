"""Photographs of pressed balls in a folder, with or without a catalogue and hand-drawn circles."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.gel.balls import BALLS_MM, Press, find_press
from calibration.gel.look_fit import Circle, Pressed
from calibration.targets.boards import SAME_VIEW_PX
from calibration.verdict import Rejected, length_guess, sift
from drivers.errors import InputError
from drivers.formats import number_in, read_csv_rows
from drivers.images import read_image
from drivers.types import Image
from rig.calibrate.samples import picture_files

CIRCLE_COLUMNS = "center_x", "center_y", "radius"
"""Columns of circles.csv beside the name of the picture, px."""


@dataclass(frozen=True, slots=True)
class Row:
    """A picture of a pressed ball. background: its own picture without contact; None for the folder's.

    move_mm: position of the ball, x right and y down; None if unknown.
    """

    name: str
    ball_mm: float
    background: Path | None = None
    move_mm: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Photograph:
    """A picture of a pressed ball. press: the detected contact, or why none was detected.

    circle: of the contact, drawn by hand if there is such a circle, else detected; None if there is none.
    """

    row: Row
    image: Image
    press: Press | str
    circle: Circle | None


@dataclass(frozen=True, slots=True)
class PressFolder:
    """The presses of a folder.

    folder: of the pictures. untouched: further frames without contact. found: presses in which a contact was
    detected. pressed: photographs with the circle of their contact. moves_mm: position of the ball by id, x
    right and y down.
    """

    folder: Path
    background: Image
    untouched: list[Image]
    found: list[Press]
    pressed: list[Pressed]
    rejected: list[Rejected]
    moves_mm: dict[str, tuple[float, float]]
    files: list[Path]


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
    still, catalogue = background or folder / "background.png", folder / "catalog.csv"
    pictures = folder / "frames" if (folder / "frames").is_dir() else folder
    rest = read_image(still)
    frames = [] if untouched is None else [read_image(path) for path in picture_files(untouched)]
    if any(image.shape != rest.shape for image in frames):
        raise InputError(f"{untouched}: has pictures of another size than {still}: use one size")
    if ball_mm is not None:
        ball_mm = _diameter_mm(ball_mm, "--ball-mm")
        rows = [Row(p.name, ball_mm) for p in picture_files(pictures) if p.stem != "background"]
    elif catalogue.exists():
        rows = _read_catalogue(folder, catalogue)
    else:
        raise InputError(f"{folder}: has no catalog.csv; give the diameter of the ball with --ball-mm")
    drawn = _circles_of(rows, pictures, circles or folder / "circles.csv", required=circles is not None)
    photographs = [_read_photograph(pictures, row, rest, drawn.get(_key(row.name))) for row in rows]
    kept, rejected = sift(photographs, lambda each: each.row.name, _fault)
    detected = [(each.row, each.press) for each in kept if isinstance(each.press, Press)]
    return PressFolder(
        folder=pictures,
        background=rest,
        untouched=frames,
        found=[press for _, press in detected],
        pressed=[
            Pressed(each.row.name, each.image, each.circle, each.row.ball_mm / 2.0)
            for each in kept
            if each.circle is not None
        ],
        rejected=rejected
        + [Rejected(each.row.name, each.press) for each in kept if isinstance(each.press, str)],
        moves_mm={row.name: row.move_mm for row, _ in detected if row.move_mm is not None},
        files=[still, *([catalogue] if ball_mm is None else []), *(pictures / row.name for row in rows)],
    )


def _read_photograph(pictures: Path, row: Row, rest: Image, drawn: Circle | None) -> Photograph:
    """Read a picture and find its contact. rest: the folder's background. drawn: circle by hand, if any."""
    background = rest if row.background is None else read_image(row.background)
    image = read_image(pictures / row.name)
    press = find_press(image, background.astype(np.float32), row.name, row.ball_mm / 2.0)
    if drawn is None and isinstance(press, Press):
        drawn = (*press.centre_px, press.rim_px)
    return Photograph(row, image, press, drawn)


def _fault(photograph: Photograph, kept: Sequence[Photograph]) -> str | None:
    """Return the fault of a photograph with a circle, among those kept so far.

    A copy of a picture, or of its row, would be in the fit while the other is held out.
    """
    circle, ball_mm = photograph.circle, photograph.row.ball_mm
    if circle is None:
        return None
    for other in kept:
        if other.circle is None or other.row.ball_mm != ball_mm:
            continue
        if np.abs(np.subtract(circle, other.circle)).max() < SAME_VIEW_PX:
            return f"same press as {other.row.name}"
    (x, y, _), (rows, columns) = circle, photograph.image.shape[:2]
    if not (0.0 <= x < columns and 0.0 <= y < rows):
        size = f"{columns} x {rows} px"
        return f"the centre of its circle, ({x:.0f}, {y:.0f}), is outside the picture of {size}"
    return None


def read_circled(folder: Path) -> tuple[Image, list[tuple[Image, Circle]]]:
    """Return background.png of a folder of presses, and each picture with its circle of circles.csv.

    The pictures are those of the folder, or of its folder `frames`; pictures without a circle are left out.
    Raises `InputError`.
    """
    circles = _read_circles(folder / "circles.csv")
    pictures = picture_files(folder / "frames" if (folder / "frames").is_dir() else folder)
    found = [(read_image(path), circles[_key(path.name)]) for path in pictures if _key(path.name) in circles]
    if not found:
        raise InputError(f"{folder / 'circles.csv'}: names no picture of {folder}")
    return read_image(folder / "background.png"), found


def _read_catalogue(folder: Path, path: Path) -> list[Row]:
    rows: list[Row] = []
    for line, row in read_csv_rows(path, ("image", "diameter(mm)")):
        where, name = f"{path} line {line}", row["image"]
        if not name or not (folder / name).is_file():
            raise InputError(f"{where}: {name} is not in {folder}")
        own = folder / row["background"] if row.get("background") else None
        moved = row.get("x_mm") and row.get("y_mm")
        move = (number_in(row, "x_mm", where), number_in(row, "y_mm", where)) if moved else None
        ball_mm = _diameter_mm(number_in(row, "diameter(mm)", where), where)
        rows.append(Row(name, ball_mm, own, move))
    return rows


def _diameter_mm(value: float, where: str) -> float:
    """Return a ball's diameter. Raises `InputError`, with a guess of the unit, unless it fits a gel."""
    low, high = BALLS_MM
    if not low <= value <= high:
        guess = length_guess(1e-3 * value, "mm", 1e-3 * low, 1e-3 * high)
        raise InputError(f"{where}: a ball of {value:g} mm; {low:g} to {high:g} mm fit a gel{guess}")
    return value


def _circles_of(rows: Sequence[Row], pictures: Path, path: Path, required: bool) -> dict[str, Circle]:
    """Read the circles of pictures by `_key`; none if the file is missing and not required."""
    if not (required or path.is_file()):
        return {}
    circles = _read_circles(path)
    if circles and circles.keys().isdisjoint(_key(row.name) for row in rows):
        raise InputError(f"{path}: names no picture of {pictures}")
    return circles


def _read_circles(path: Path) -> dict[str, Circle]:
    """Read circles by the `_key` of their picture."""
    found: dict[str, Circle] = {}
    for line, row in read_csv_rows(path, CIRCLE_COLUMNS):
        where = f"{path} line {line}"
        name = row.get("frame") or row.get("image")
        if not name:
            raise InputError(f"{where}: column frame (or image) names no picture")
        x, y, radius = (number_in(row, column, where) for column in CIRCLE_COLUMNS)
        if radius <= 0.0:
            raise InputError(f"{where}: a circle's radius is {radius:g} px; it must be positive")
        if _key(name) in found:
            raise InputError(f"{where}: {name} has a circle already: keep one")
        found[_key(name)] = x, y, radius
    return found


def _key(name: str) -> str:
    """Return the name of a picture without suffix and leading zeros."""
    return Path(name).stem.lstrip("0") or "0"
