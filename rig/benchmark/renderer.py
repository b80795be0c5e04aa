"""Lifts drawn by a second renderer, with ground truth. It shares no code with the simulated bench.

An object rests, turns in stick and slip, and rests again, at two fingertips. Its faces are height maps in mm
over x (right) and y (up), drawn from seeds. A fingertip is a gel with a camera behind it. The film on the gel
is a membrane on an elastic foundation, stretched over the face. It is lit by extended lamps. Its reflection
is diffuse and slightly glossy. The light is scattered in the gel; the camera applies a tone curve and adds
noise.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.benchmark.estimators.contenders import KnownLift
from rig.frames.of_session import SessionSeries
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime
from rig.tactile.angles import Angles
from rig.tactile.contact.background import mean_background

Plane = NDArray[np.float32]
Random = np.random.Generator
PATCH_MM, PATCH_PX_MM = 16.0, 0.1  # half the width of the square of a height map, and size of its pixels
AWAY_MM = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """The face at one fingertip.

    bulge_mm: radii of curvature of a soft broad body behind it, along and across `bulge_deg`, which presses
    the gel and does not turn; None without one.
    """

    relief_mm: Plane  # (N, N) float32, distance below the face's highest point; it turns with the object
    bulge_mm: tuple[float, float] | None = None
    bulge_deg: float = 0.0


STIFF = ("bar", "blade", "thread", "braid", "oval", "strokes", "porous")
SOFT = ("soft with lines", "soft with an edge", "soft peel")  # bodies with slight relief
KIND_NAMES = (*STIFF, *SOFT)


def kind_of(seed: int) -> str:
    return KIND_NAMES[seed % len(KIND_NAMES)]


def _relief(kind: str, x: Plane, y: Plane, rng: Random) -> NDArray[np.floating]:
    """Draw the height map of a face in mm; its highest point is at any height."""
    if kind == "bar":  # rounded, with a width that changes along it, sometimes with an end
        radius = rng.uniform(2.0, 7.0) * (1.0 + rng.uniform(0.0, 0.03) * x)
        end = np.maximum(np.abs(x) - rng.uniform(4.0, 14.0), 0.0)
        bend = rng.uniform(-0.01, 0.01) * x**2
        return np.minimum((y - bend) ** 2 / (2.0 * np.maximum(radius, 1.0)) + 0.6 * end, AWAY_MM)
    if kind == "blade":  # flat, slightly tapered, with sharp long edges
        half = rng.uniform(1.0, 3.2) + rng.uniform(-0.06, 0.06) * x
        return np.minimum(np.maximum(np.abs(y) - half, 0.0) * rng.uniform(1.5, 4.0), AWAY_MM)
    if kind == "thread":  # a rod with a helical ridge
        pitch, slant = rng.uniform(0.9, 2.2), rng.uniform(0.05, 0.4)
        ridge = rng.uniform(0.08, 0.2) * (1.0 - np.cos(2.0 * np.pi * (x + slant * y) / pitch)) / 2.0
        return np.minimum(y**2 / (2.0 * rng.uniform(3.0, 8.0)), AWAY_MM) + ridge
    if kind == "braid":  # two crossing sets of ridges
        pitch, half = rng.uniform(1.2, 2.5), rng.uniform(0.4, 0.9)
        one = np.cos(2.0 * np.pi * (x * np.cos(half) + y * np.sin(half)) / pitch)
        two = np.cos(2.0 * np.pi * (x * np.cos(half) - y * np.sin(half)) / pitch)
        side = np.maximum(np.abs(y) - rng.uniform(2.5, 6.0), 0.0)
        return rng.uniform(0.05, 0.15) * (2.0 - one - two) / 2.0 + 0.5 * side
    if kind == "oval":  # a smooth cap, clearly longer than wide
        across = rng.uniform(6.0, 12.0)
        along = across * rng.uniform(2.2, 5.0)
        return np.minimum(x**2 / (2.0 * along) + y**2 / (2.0 * across), AWAY_MM)
    if kind == "strokes":  # a plate with raised strokes, as of letters
        picture = np.ones(x.shape, np.float32)
        for _ in range(int(rng.integers(4, 9))):
            ends = x.shape[0] / 2.0 + rng.uniform(-5.0, 5.0, (2, 2)) / PATCH_PX_MM
            start, stop = (tuple(int(v) for v in end) for end in ends)
            cv2.line(picture, start, stop, 0.0, int(rng.uniform(0.5, 1.1) / PATCH_PX_MM))
        soft = cv2.GaussianBlur(picture, (0, 0), 1.5)
        beside = np.maximum(np.hypot(x, y) - rng.uniform(5.0, 8.0), 0.0) * 0.5
        return rng.uniform(0.15, 0.35) * soft + beside
    if kind == "soft with lines":  # one to three thin, low lines, straight or slightly bent, as of a handle
        relief = np.zeros_like(x)
        for _ in range(int(rng.integers(1, 4))):
            away = y - rng.uniform(-3.0, 3.0) - rng.uniform(-0.3, 0.3) * x - rng.uniform(-0.02, 0.02) * x**2
            relief -= rng.uniform(0.05, 0.14) * np.exp(-((away / rng.uniform(0.25, 0.5)) ** 2))
        return relief
    if kind == "soft with an edge":  # a flat face that ends on the gel, with a gentle slope beyond its edge
        away = y - rng.uniform(1.0, 3.0) - rng.uniform(-0.2, 0.2) * x - rng.uniform(-0.006, 0.006) * x**2
        bite = rng.uniform(0.04, 0.11) * np.exp(-((away / rng.uniform(0.25, 0.45)) ** 2))
        return np.minimum(rng.uniform(0.08, 0.4) * np.maximum(away, 0.0), AWAY_MM) - bite
    rough = rng.standard_normal(x.shape).astype(np.float32)
    if kind == "porous":  # a broad, slightly elongated cap of rough material
        fine, coarse = (cv2.GaussianBlur(rough, (0, 0), s / PATCH_PX_MM) for s in (0.25, 0.8))
        cap = np.minimum(x**2 / 60.0 + y**2 / rng.uniform(20.0, 50.0), AWAY_MM)
        return rng.uniform(0.03, 0.07) * (fine / fine.std() + coarse / coarse.std()) + cap
    bumps = cv2.GaussianBlur(rough, (0, 0), rng.uniform(0.25, 0.5) / PATCH_PX_MM)  # a fruit's skin, with pits
    pits = np.maximum(cv2.GaussianBlur(rough[::-1], (0, 0), 0.4 / PATCH_PX_MM) / 0.07 - 2.0, 0.0)
    return rng.uniform(0.008, 0.025) * bumps / bumps.std() + 0.04 * pits


def draw_face(kind: str, seed: int, side: int) -> Face:
    """Draw a face. side: 0 or 1; the second fingertip touches the mirror image of the first one's face."""
    axis = np.arange(-PATCH_MM, PATCH_MM, PATCH_PX_MM, dtype=np.float32) + PATCH_PX_MM / 2
    x, y = (of.astype(np.float32) for of in np.meshgrid(-axis if side else axis, -axis))
    rng = np.random.default_rng((seed, 1))
    drawn = _relief(kind, x, y, rng)
    relief = (drawn - drawn.min()).astype(np.float32)
    if kind in STIFF:
        return Face(relief)
    radii = (float(rng.uniform(14.0, 40.0)), float(rng.uniform(10.0, 18.0)))
    return Face(relief, radii, float(rng.uniform(0.0, 180.0)))


SIZE_PX = (240, 320)
PITCH_MM = 0.058
COARSE = 2  # pixels of the image per grid point of the film
STRETCH_PX, STRETCHES = 2.6, 14
"""Stiffness of the film: width of its smoothing, and number of repetitions. Each is followed by contact with
the face."""
SINKS = 0.985  # fraction of the film's depth that remains after each smoothing, due to the elastic foundation
LAMPS = 5  # number of point lights that represent a row of lamps
HEIGHT_MM, AWAY_FROM_MIDDLE_MM = 3.0, 15.0
GLOSS, GLOSS_POWER = 0.10, 12.0
SPREAD_PX, SPREAD_SHARE = 9.0, 0.18
TONE = 1.0 / 1.6
BLOCK_PX = 16


class GelCamera:
    """One sensor: its lamps, gel and camera, drawn from a seed."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng((seed, 2))
        columns, rows = SIZE_PX[0] // COARSE, SIZE_PX[1] // COARSE
        across = (np.arange(columns) - (columns - 1) / 2.0) * PITCH_MM * COARSE
        down = (np.arange(rows) - (rows - 1) / 2.0) * PITCH_MM * COARSE
        self._x, self._y = (np.asarray(m, np.float32) for m in np.meshgrid(across, -down))
        self._dome = (self._x**2 + self._y**2) / np.float32(2.0 * rng.uniform(40.0, 90.0))
        self._lamps = _lamps(rng)
        self._mix = np.eye(3) * rng.uniform(0.8, 1.2, 3) + rng.uniform(0.02, 0.18, (3, 3))
        self._glow = rng.uniform(0.1, 0.4)
        patches = rng.normal(0.0, 0.12, (5, 4, 3)).astype(np.float32)
        wide = cv2.resize(patches, (columns, rows), interpolation=cv2.INTER_CUBIC)
        self._patchy = np.exp(wide).astype(np.float64)
        self._specks = _specks(rng)
        self._gain = float(rng.uniform(95.0, 150.0))
        self._read_noise, self._shot = float(rng.uniform(0.6, 1.6)), float(rng.uniform(0.02, 0.08))
        self._quality = int(rng.integers(60, 92))
        self._blocks, self._taken = np.zeros((*SIZE_PX[::-1], 3), np.float32), 0
        self.refresh, self._block_levels = int(rng.integers(15, 60)), float(rng.uniform(0.0, 1.0))
        self._level = 1.0
        flat = self._light(np.zeros_like(self._dome))
        self._level = float(1.0 / np.percentile(flat, 90))

    def picture(
        self,
        face: Face | None,
        angle_rad: float,
        middle_mm: tuple[float, float],
        depth_mm: float,
        rng: Random,
    ) -> Image:
        """Return a frame of the camera, (320, 240, 3) uint8 RGB.

        angle_rad: counter-clockwise as seen. middle_mm: position of the face's middle, right and up.
        depth_mm: depth of the face in the gel.
        """
        depth = np.zeros_like(self._dome)
        if face is not None:
            depth = self._stretch(self._press(face, angle_rad, middle_mm, depth_mm))
        light = self._light(depth) * self._level
        wide = cv2.resize(light.astype(np.float32), SIZE_PX, interpolation=cv2.INTER_CUBIC)
        seen = cv2.resize(depth, SIZE_PX, interpolation=cv2.INTER_LINEAR)
        wide = wide * (1.0 - self._specks * (0.6 + 0.8 * np.minimum(seen, 0.5)))[..., None]
        grey = self._gain * np.maximum(wide, 0.0) ** TONE
        sigma = np.sqrt(self._read_noise**2 + self._shot * grey)
        grey = grey + sigma * rng.standard_normal(grey.shape, np.float32) + self.draw_codec_errors(rng)
        frame = np.clip(grey, 0, 255).astype(np.uint8)
        _, data = cv2.imencode(".jpg", frame[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, self._quality))
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)[..., ::-1].copy()

    def draw_codec_errors(self, rng: Random) -> NDArray[np.float32]:
        """Return the errors of a video codec's blocks until the next refresh, (H, W, 3) grey levels."""
        if self._taken % self.refresh == 0:
            coarse = (SIZE_PX[1] // BLOCK_PX, SIZE_PX[0] // BLOCK_PX, 3)
            levels = rng.normal(0.0, self._block_levels, coarse).astype(np.float32)
            self._blocks = levels.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
        self._taken += 1
        return self._blocks

    def _press(self, face: Face, angle_rad: float, middle_mm: tuple[float, float], depth_mm: float) -> Plane:
        """Return the depth of the face below the undented gel, mm, 0 outside the contact."""
        x, y = self._x - np.float32(middle_mm[0]), self._y - np.float32(middle_mm[1])
        cos, sin = np.float32(math.cos(angle_rad)), np.float32(math.sin(angle_rad))
        column = (x * cos + y * sin + np.float32(PATCH_MM)) / np.float32(PATCH_PX_MM) - np.float32(0.5)
        row = (np.float32(PATCH_MM) - (y * cos - x * sin)) / np.float32(PATCH_PX_MM) - np.float32(0.5)
        relief = cv2.remap(
            face.relief_mm, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=AWAY_MM
        )
        away = np.asarray(relief, np.float32) + self._dome
        if face.bulge_mm is not None:
            turn = math.radians(face.bulge_deg)
            along = x * np.float32(math.cos(turn)) + y * np.float32(math.sin(turn))
            across = y * np.float32(math.cos(turn)) - x * np.float32(math.sin(turn))
            away = away + along**2 / np.float32(2 * face.bulge_mm[0])
            away = away + across**2 / np.float32(2 * face.bulge_mm[1])
        return np.maximum(np.float32(depth_mm) - away, np.float32(0.0))

    @staticmethod
    def _stretch(pressed: Plane) -> Plane:
        """Return the film's depth: at least that of the face, and smooth beside it."""
        film = pressed
        for _ in range(STRETCHES):
            smooth = np.asarray(cv2.GaussianBlur(film, (0, 0), STRETCH_PX), np.float32)
            film = np.maximum(pressed, np.float32(SINKS) * smooth)
        return np.asarray(cv2.GaussianBlur(film, (0, 0), 0.7), np.float32)

    def _light(self, depth: Plane) -> NDArray[np.float64]:
        """Return the light that leaves the film towards the camera, (h, w, 3)."""
        step = COARSE * PITCH_MM
        right = -cv2.Sobel(depth, cv2.CV_32F, 1, 0, scale=1 / (8 * step))
        up = cv2.Sobel(depth, cv2.CV_32F, 0, 1, scale=1 / (8 * step))
        # The camera is inside: parts of the film that are pressed in are closer to the camera.
        norm = np.sqrt(1.0 + right**2 + up**2)
        colours = np.empty((*depth.shape, 3))
        for colour, lamps in enumerate(self._lamps):
            light = np.zeros_like(depth)
            for x, y, power in lamps:
                to_x, to_y = np.float32(x) - self._x, np.float32(y) - self._y
                far = np.sqrt(to_x**2 + to_y**2 + np.float32(HEIGHT_MM**2))
                facing = (right * to_x + up * to_y + np.float32(HEIGHT_MM)) / (norm * far)
                half = np.maximum(2.0 * facing / norm - np.float32(HEIGHT_MM) / far, 0.0)
                shed = np.maximum(facing, 0.0) + np.float32(GLOSS) * half ** np.float32(GLOSS_POWER)
                light += np.float32(power) * shed / far**2
            colours[..., colour] = light
        colours = (colours * 1000.0) @ self._mix * self._patchy + self._glow
        spread = cv2.GaussianBlur(colours, (0, 0), SPREAD_PX)
        return (1.0 - SPREAD_SHARE) * colours + SPREAD_SHARE * spread


def _lamps(rng: Random) -> list[list[tuple[float, float, float]]]:
    first = rng.uniform(0.0, 2.0 * math.pi)
    rows = []
    for colour in range(3):
        middle = first + colour * 2.0 * math.pi / 3.0 + rng.normal(0.0, 0.2)
        around = middle + np.linspace(-0.45, 0.45, LAMPS)
        away = AWAY_FROM_MIDDLE_MM * rng.uniform(0.9, 1.3)
        power = rng.uniform(0.7, 1.3) / LAMPS
        rows.append([(away * math.cos(a), away * math.sin(a), power * rng.uniform(0.7, 1.3)) for a in around])
    return rows


def _specks(rng: Random) -> NDArray[np.float64]:
    """Return the fraction of light absorbed by specks and a scratch, (H, W), 0 to 1."""
    dark = np.zeros((SIZE_PX[1], SIZE_PX[0]), np.float32)
    for _ in range(int(rng.integers(2, 9))):
        place = int(rng.integers(SIZE_PX[0])), int(rng.integers(SIZE_PX[1]))
        cv2.circle(dark, place, int(rng.integers(1, 4)), float(rng.uniform(0.1, 0.5)), -1)
    if rng.random() < 0.4:
        ends = [(int(rng.integers(SIZE_PX[0])), int(rng.integers(SIZE_PX[1]))) for _ in range(2)]
        cv2.line(dark, ends[0], ends[1], float(rng.uniform(0.05, 0.2)), 1)
    return cv2.GaussianBlur(dark, (0, 0), 0.8).astype(np.float64)


RATE_HZ = 60.0
REST_S, TURN_S, END_S = 1.0, 1.6, 0.6
BACKGROUND_FRAMES = 8
MOST_TURN_DEG, LEAST_TURN_DEG = 45.0, 5.0
STILL_SHARE = 0.1  # fraction of the lifts without rotation
SIGNS = (1, -1)  # signs of the fingertips, which are on opposite sides of the object


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """The motion of a lift, at each frame."""

    turn_deg: NDArray[np.float64]  # (N,) rotation of the object
    shift_mm: NDArray[np.float64]  # (N, 2) position of the face's middle, right and up
    depth_mm: NDArray[np.float64]  # (N,) depth of the face in the gel

    @property
    def time_ns(self) -> NDArray[np.int64]:
        return np.rint((1.0 + np.arange(len(self.turn_deg)) / RATE_HZ) * NS_PER_S).astype(np.int64)


LIFT_NS = round((1.0 + REST_S) * NS_PER_S)  # start of the lift: the zero of the angles is the mean before it
HOLD_NS = LIFT_NS + round(TURN_S * NS_PER_S)


def draw_course(seed: int) -> Course:
    rng = np.random.default_rng((seed, 3))
    frames = round((REST_S + TURN_S + END_S) * RATE_HZ)
    since_s = np.arange(frames) / RATE_HZ - REST_S
    turn_deg = _stick_slip(np.clip(since_s, 0.0, TURN_S), rng)
    share = np.clip(since_s / TURN_S, 0.0, 1.0)
    grown = 1.0 + rng.uniform(-0.25, 0.5) * share
    swing = 0.04 * np.sin(2.0 * math.pi * rng.uniform(0.4, 1.2) * since_s) * (since_s > 0)
    depth_mm = rng.uniform(0.35, 0.8) * (grown + swing)
    start, moved = rng.normal(0.0, 0.8, 2), rng.normal(0.0, 0.7, 2)
    return Course(turn_deg, start + moved * share[:, None], depth_mm)


def frames(seed: int, tip: int) -> Iterator[TimedFrame]:
    """Yield a fingertip's frames: first `BACKGROUND_FRAMES` of the empty gel, at time 0, then the lift's."""
    course, camera = draw_course(seed), GelCamera(10 * seed + tip)
    face = draw_face(kind_of(seed), seed, tip)
    rng = np.random.default_rng((seed, 4, tip))
    placed_rad = float(np.random.default_rng((seed, 5)).uniform(-math.pi, math.pi))
    for _ in range(BACKGROUND_FRAMES):
        empty = camera.picture(None, 0.0, (0.0, 0.0), 0.0, rng)
        yield TimedFrame("background", FrameTime("0", 0), empty)
    drawn = zip(course.time_ns.tolist(), course.turn_deg, course.shift_mm, course.depth_mm, strict=True)
    for time_ns, turn, shift, depth in drawn:
        angle = SIGNS[tip] * (placed_rad + math.radians(turn))
        middle = (SIGNS[tip] * float(shift[0]), float(shift[1]))
        image = camera.picture(face, angle, middle, float(depth), rng)
        yield TimedFrame(f"frame at {time_ns}", FrameTime(str(time_ns / NS_PER_S), time_ns), image)


def draw_lift(seed: int) -> KnownLift:
    course, name = draw_course(seed), f"{kind_of(seed)}/{seed}"

    def tip(number: int) -> SessionSeries:
        drawn = list(frames(seed, number))
        empty = [of.image for of in drawn[:BACKGROUND_FRAMES] if of.image is not None]
        series = FrameSeries(name, lambda: iter(drawn[BACKGROUND_FRAMES:]))
        return SessionSeries(name, str(number), SIGNS[number], 1.0, mean_background(empty), series)

    tips = {str(number): tip(number) for number in range(len(SIGNS))}
    turn_deg = course.turn_deg - course.turn_deg[0]
    truth = Angles(course.time_ns / NS_PER_S, turn_deg, np.zeros_like(turn_deg))
    return KnownLift(name, tips, truth, LIFT_NS, HOLD_NS, int(course.time_ns[-1]) + 1)


def _stick_slip(since_s: NDArray[np.float64], rng: Random) -> NDArray[np.float64]:
    """Return the rotation, degrees, at times from 0 on: phases of constant rate with rests between them."""
    if rng.random() < STILL_SHARE:
        return np.zeros_like(since_s)
    ends = np.sort(rng.uniform(0.0, TURN_S, int(rng.integers(2, 7)) * 2))
    moving = np.concatenate([[0.05], ends, [TURN_S]])
    rates = np.where(np.arange(len(moving) - 1) % 2 == 0, rng.uniform(0.3, 1.0, len(moving) - 1), 0.0)
    reached = np.concatenate([[0.0], np.cumsum(rates * np.diff(moving))])
    total = rng.uniform(LEAST_TURN_DEG, MOST_TURN_DEG) * rng.choice([-1.0, 1.0])
    return np.asarray(np.interp(since_s, moving, reached * total / reached[-1]), np.float64)
