"""Render the simulated external camera's image: a bar-shaped object with two printed markers, or a sheet.

The markers and the bar are in the object's x-z plane and face the camera. They are one texture, with edges
accurate to a fraction of a texel, which is blurred as by the lens before it is sampled once per pixel.
Because a homography is nearly affine over the width of the blur, the result is the blurred image, ten times
faster than with supersampling. A printed calibration target, a flat sheet on a grey bench, is supersampled.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image, Pose
from fakes.world.fixture import Sheet

Plane = NDArray[np.floating]
QUIET_ZONE = 0.25
"""Width of the white margin of paper around a marker, as a fraction of the marker's side."""
_PAPER_RGB, _INK_RGB = (225, 225, 225), (25, 25, 25)


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """A texture to draw on; a texel that an edge crosses is painted in proportion to the covered area.

    rgba: (H, W, 4) float32, 0 to 255, premultiplied. top_left_m: (x, z) of its corner. density: texels per m.
    """

    rgba: NDArray[np.float32]
    top_left_m: Plane
    density: float

    def paint(self, low_m: Plane, high_m: Plane, rgb: tuple[int, int, int], ink: Plane | None = None) -> None:
        """Paint a rectangle. low_m, high_m: (x, z) of its corners. ink: (n, n), 1 for a painted cell."""
        ink = np.ones((1, 1), np.float32) if ink is None else ink
        rows, columns = self.rgba.shape[:2]
        left, right = (np.array([low_m[0], high_m[0]]) - self.top_left_m[0]) * self.density
        top, bottom = (self.top_left_m[1] - np.array([high_m[1], low_m[1]])) * self.density
        share = _coverage(top, bottom, len(ink), rows).T @ ink @ _coverage(left, right, len(ink), columns)
        self.rgba[...] += share[..., None] * (np.array([*rgb, 255], np.float32) - self.rgba)


def _coverage(start: float, end: float, count: int, length: int) -> Plane:
    """Return the fraction of each of `length` texels in `count` equal cells, (count, length) float32."""
    edges = np.linspace(start, end, count + 1)[:, None]
    texel = np.arange(length)[None, :]
    covered = np.minimum(texel + 1, edges[1:]) - np.maximum(texel, edges[:-1])
    return np.clip(covered, 0.0, 1.0).astype(np.float32)


_TEXELS_PER_PX = 4.0
_SCALE_STEP = 1.05
_PIXEL_VARIANCE = 1.0 / 12.0
_NOISE_BLUR_PX = 0.6
_NOISE_SHIFTS = 128


_Texture = tuple[Image, NDArray[np.float64]]
"""Of the object's plane: (H, W, 4) uint8, premultiplied RGB and opacity; matrix (3, 3) from plane coordinates
(x, z, 1) in m to texels, whose centres are integers."""


@dataclass(eq=False)
class MarkerScene:
    """Renders images of two markers on an object, with exact ground truth.

    focal_px: focal length; the principal point is the centre of the image. unit_seed: seed of the clutter and
    the noise fields, which stay the same for one camera and bench. size: width and height in px.
    marker_centres_m: (x, z) in the object frame (x along the object, z up, y away from the camera). bar_m:
    length and height of the object. blur_px: standard deviation of the lens blur. noise_grey: standard
    deviation per pixel. k1: OpenCV's radial distortion coefficient. Raises `InputError` for an unknown
    dictionary.
    """

    focal_px: float
    unit_seed: int
    size: tuple[int, int] = (640, 480)
    marker_ids: tuple[int, int] = (0, 1)
    marker_side_m: float = 0.04
    marker_centres_m: tuple[tuple[float, float], tuple[float, float]] = ((-0.06, 0.0), (0.06, 0.0))
    dictionary: str = "DICT_4X4_50"
    bar_m: tuple[float, float] = (0.24, 0.024)
    object_rgb: tuple[int, int, int] = (150, 110, 70)
    blur_px: float = 0.8
    noise_grey: float = 1.5
    k1: float = 0.0

    def __post_init__(self) -> None:
        if not hasattr(cv2.aruco, self.dictionary):
            raise InputError(f"marker scene: OpenCV has no marker dictionary {self.dictionary!r}")
        rng, (width, height) = np.random.default_rng(self.unit_seed), self.size
        x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
        light = np.rint(255.0 * (1.0 - 0.14 * x - 0.10 * y)).astype(np.uint8)
        self._light: Image = np.repeat(light[..., None], 3, axis=2)
        """Illumination of the bench, (H, W, 3) uint8, 255 at the brightest place."""
        self._bench = _draw_bench(self._light, rng)
        self._noise = _noise_fields(self.size, self.noise_grey, rng)
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        distorted = (grid - self.camera_matrix[:2, 2]) / self.camera_matrix[0, 0]
        rays = distorted.copy()
        for _ in range(30 if self.k1 else 0):
            rays = distorted / (1.0 + self.k1 * (rays**2).sum(axis=-1, keepdims=True))
        self._rays = rays.astype(np.float32)
        """Undistorted ray (x/z, y/z) of every pixel centre, (H, W, 2) float32."""
        self._textures: dict[int, _Texture] = {}
        self._drawn: tuple[Pose, Image] | None = None
        """The newest pose, and its picture without noise: an object at rest is drawn once."""

    @property
    def camera_matrix(self) -> NDArray[np.float64]:
        """Camera matrix (3, 3); pixel centres have integer coordinates."""
        width, height = self.size
        f = self.focal_px
        return np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> NDArray[np.float64]:
        """OpenCV's coefficients k1, k2, p1, p2, k3, (5,)."""
        return np.array([self.k1, 0.0, 0.0, 0.0, 0.0])

    def render(self, camera_T_object: Pose, rng: np.random.Generator) -> Image:  # noqa: N803
        """Return the image (H, W, 3) uint8 RGB of the object at a pose.

        camera_T_object: in camera axes x right, y down, z forward. Parts outside the image are clipped. An
        object behind the camera, or whose back faces the camera, is not drawn. Draws two numbers from `rng`,
        so generators with equal states give equal images.
        """
        drawn = self._drawn
        if drawn is None or drawn[0] != camera_T_object:
            picture = self._bench.copy()
            self._draw_object(picture, _plane(camera_T_object))
            drawn = self._drawn = camera_T_object, picture
        width, height = self.size
        dx, dy = rng.integers(0, _NOISE_SHIFTS, 2)
        window = np.s_[dy : dy + height, dx : dx + width]
        picture = np.asarray(cv2.add(drawn[1], self._noise[0][window]), np.uint8)
        return cv2.subtract(picture, self._noise[1][window], dst=picture)  # type: ignore[return-value]

    def exact_corners_px(self, camera_T_object: Pose) -> NDArray[np.float64]:  # noqa: N803
        """Return the true corners of the markers, (2, 4, 2) px, clockwise from the top left of each."""
        half = self.marker_side_m / 2
        square = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
        points = np.asarray(self.marker_centres_m)[:, None, :] + square
        return self._project(points.reshape(-1, 2), _plane(camera_T_object)).reshape(2, 4, 2)

    def _project(self, plane_m: Plane, camera_T_plane: Plane) -> NDArray[np.float64]:  # noqa: N803
        """Project (N, 2) plane coordinates (x, z) to (N, 2) px, with distortion."""
        rays = np.column_stack([plane_m, np.ones(len(plane_m))]) @ camera_T_plane.T
        flat = rays[:, :2] / rays[:, 2:]
        flat *= 1.0 + self.k1 * (flat**2).sum(axis=1, keepdims=True)
        return self.focal_px * flat + self.camera_matrix[:2, 2]

    def _draw_object(self, picture: Image, camera_T_plane: NDArray[np.float64]) -> None:  # noqa: N803
        outline = self._outline_m()
        depth = (np.column_stack([outline, np.ones(4)]) @ camera_T_plane.T)[:, 2]
        # The determinant is (x cross z) . position; it is negative if the markers face the camera.
        if depth.min() <= 0.01 or np.linalg.det(camera_T_plane) >= 0.0:
            return
        seen = self._project(outline, camera_T_plane)
        low = np.maximum(np.floor(seen.min(axis=0)) - 4, 0).astype(int)
        high = np.minimum(np.ceil(seen.max(axis=0)) + 5, self.size).astype(int)
        if (high <= low).any():
            return
        window = np.s_[low[1] : high[1], low[0] : high[0]]
        # The blur of the texture depends on the distance; distances within 5 % share one texture.
        step = round(math.log(self.focal_px / float(depth.mean()), _SCALE_STEP))
        if step not in self._textures:
            self._textures[step] = self._draw_texture(_SCALE_STEP**step)
        texture, texel_T_plane = self._textures[step]  # noqa: N806
        where = cv2.perspectiveTransform(self._rays[window], texel_T_plane @ np.linalg.inv(camera_T_plane))
        rgba = cv2.remap(texture, where, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        opacity = cv2.bitwise_not(cv2.extractChannel(rgba, 3))
        behind = cv2.multiply(picture[window], cv2.merge([opacity] * 3), scale=1 / 255)
        lit = cv2.multiply(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), self._light[window], scale=1 / 255)
        picture[window] = cv2.add(behind, lit)

    def _outline_m(self) -> NDArray[np.float64]:
        """Return the corners (4, 2), (x, z) in m, of a rectangle around the bar, the paper and the blur."""
        reach = self.marker_side_m * (0.5 + QUIET_ZONE)
        centres = np.asarray(self.marker_centres_m)
        half_bar = np.asarray(self.bar_m) / 2
        low = np.minimum(centres.min(axis=0) - reach, -half_bar) - self.marker_side_m / 8
        high = np.maximum(centres.max(axis=0) + reach, half_bar) + self.marker_side_m / 8
        return np.array([[low[0], high[1]], [high[0], high[1]], [high[0], low[1]], [low[0], low[1]]])

    def _draw_texture(self, px_per_m: float) -> _Texture:
        top_left_m, _, bottom_right_m, _ = self._outline_m()
        density = _TEXELS_PER_PX * px_per_m
        columns, rows = np.ceil(np.abs(bottom_right_m - top_left_m) * density).astype(int)
        canvas = Canvas(np.zeros((rows, columns, 4), np.float32), top_left_m, density)
        half = np.asarray(self.bar_m) / 2
        canvas.paint(-half, half, self.object_rgb)
        reach_m, side_m = self.marker_side_m * (0.5 + QUIET_ZONE), self.marker_side_m
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        modules = dictionary.markerSize + 2  # with the border
        for marker_id, centre in zip(self.marker_ids, self.marker_centres_m, strict=True):
            ink = (cv2.aruco.generateImageMarker(dictionary, marker_id, modules) == 0).astype(np.float32)
            centre_m = np.asarray(centre)
            canvas.paint(centre_m - reach_m, centre_m + reach_m, _PAPER_RGB)
            canvas.paint(centre_m - side_m / 2, centre_m + side_m / 2, _INK_RGB, ink)
        sigma = _TEXELS_PER_PX * math.hypot(self.blur_px, math.sqrt(_PIXEL_VARIANCE))
        blurred = cv2.GaussianBlur(canvas.rgba, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        x, z = top_left_m
        texel_T_plane = np.array(  # noqa: N806 - frame names keep their case
            [[density, 0.0, -density * x - 0.5], [0.0, -density, density * z - 0.5], [0.0, 0.0, 1.0]]
        )
        return np.rint(blurred).astype(np.uint8), texel_T_plane


def _plane(camera_T_object: Pose) -> NDArray[np.float64]:  # noqa: N803
    """Return the matrix (3, 3) from the object's plane coordinates (x, z, 1) to camera coordinates, m."""
    rotation = camera_T_object.rotation.as_matrix()
    return np.column_stack([rotation[:, 0], rotation[:, 2], camera_T_object.position_m])


def _draw_bench(light: Image, rng: np.random.Generator) -> Image:
    """Draw the background, (H, W, 3) uint8 RGB: a wall with clutter and a table in front, out of focus."""
    height, width = light.shape[:2]
    bench = np.full((height, width, 3), (96, 99, 104), np.uint8)
    for _ in range(6):
        corner = rng.integers((0, 0), (width, height))
        reach = rng.integers(20, 120, 2)
        colour = [int(v) for v in rng.integers(60, 150, 3)]
        cv2.rectangle(bench, corner.tolist(), (corner + reach).tolist(), colour, cv2.FILLED)
    cv2.rectangle(bench, (0, int(0.8 * height)), (width, height), (62, 56, 52), cv2.FILLED)
    return cv2.multiply(cv2.GaussianBlur(bench, (0, 0), 2.0), light, scale=1 / 255)  # type: ignore[return-value]


def _noise_fields(size: tuple[int, int], sigma_grey: float, rng: np.random.Generator) -> tuple[Image, Image]:
    """Return two noise fields (H + n, W + n, 3) uint8, to add and to subtract, equal in all channels."""
    width, height = size
    white = rng.normal(0.0, 1.0, (height + _NOISE_SHIFTS, width + _NOISE_SHIFTS))
    # A colour camera interpolates its Bayer mosaic, which correlates the noise of neighbouring pixels.
    shared = cv2.GaussianBlur(white, (0, 0), _NOISE_BLUR_PX)
    noise = np.rint(shared * (sigma_grey / shared.std()))
    signs = (np.clip(noise, 0, 255), np.clip(-noise, 0, 255))
    plus, minus = (np.repeat(field.astype(np.uint8)[..., None], 3, axis=2) for field in signs)
    return plus, minus


_FINE = 2
"""Samples of a sheet per pixel along each axis."""
_BENCH_GREY = 120
_BLUR_PX = 0.8
_NOISE_GREY = 1.5


def render_sheet(
    sheet: Sheet, camera_matrix: NDArray[np.float64], size: tuple[int, int], camera_T_target: Pose,  # noqa: N803
    rng: np.random.Generator,
) -> Image:  # fmt: skip
    """Return the image (H, W, 3) uint8 of a sheet in a pinhole camera. rng: draws the noise.

    A sheet whose back faces the camera, or whose origin is less than 5 cm in front of it, is not drawn.
    """
    width, height = size
    turn, place = camera_T_target.rotation.as_matrix(), np.asarray(camera_T_target.position_m)
    plane = np.column_stack([turn[:, :2], place])
    seen = np.full((height, width), np.float32(_BENCH_GREY))
    if place @ turn[:, 2] > 0.0 and place[2] > 0.05:
        wanted_px_per_m = _FINE * float(camera_matrix[0, 0]) / float(np.linalg.norm(place))
        # reduced to about twice the wanted density, so that sampling it does not alias
        coarse = _reduce(sheet, max(1, int(sheet.px_per_m / (2.0 * wanted_px_per_m))))
        scale, (x, y) = coarse.px_per_m, coarse.origin_m
        sheet_T_plane = np.array(  # noqa: N806 - frame names keep their case
            [[scale, 0.0, -x * scale - 0.5], [0.0, scale, -y * scale - 0.5], [0.0, 0.0, 1.0]]
        )
        # pixel centres are integers in the supersampled image too
        finer = np.array([[_FINE, 0, (_FINE - 1) / 2], [0, _FINE, (_FINE - 1) / 2], [0, 0, 1.0]])
        fine_T_sheet = finer @ camera_matrix @ plane @ np.linalg.inv(sheet_T_plane)  # noqa: N806
        fine = cv2.warpPerspective(
            coarse.grey, fine_T_sheet, (_FINE * width, _FINE * height), borderValue=_BENCH_GREY
        )
        seen = cv2.resize(fine.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(seen, (0, 0), _BLUR_PX)
    blurred += rng.standard_normal((height, width), np.float32) * np.float32(_NOISE_GREY)
    return np.repeat(np.clip(np.rint(blurred), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@lru_cache(maxsize=16)
def _reduce(sheet: Sheet, step: int) -> Sheet:
    rows, columns = (n // step * step for n in sheet.grey.shape)
    small = cv2.resize(
        sheet.grey[:rows, :columns], (columns // step, rows // step), interpolation=cv2.INTER_AREA
    )
    return Sheet(np.asarray(small, np.uint8), sheet.origin_m, sheet.px_per_m / step)
