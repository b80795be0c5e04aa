"""The calibrations that a session uses, stored with its bench, so that a replay uses the same ones."""

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.gel.look import GelLook
from calibration.gel.noise import CameraNoise
from drivers.types import Pose
from rig.config.fields import Section, Strict

Aspect = Annotated[float, Field(ge=0.5, le=2.0)]
TimeShift = Annotated[float, Field(ge=-1.0, le=1.0)]
"""s; with a larger clock offset, a sensor is not usable for a lift."""
Counts = Annotated[float, Field(ge=0, le=255)]
Opening = Annotated[float, Field(ge=-0.2, le=0.2)]
"""m; negative if the fingers would close beyond each other."""
Term = Annotated[int, Field(ge=0, le=11)]
OpeningPairs = tuple[tuple[float, float], ...]


def _closing(pairs: OpeningPairs) -> OpeningPairs:
    """Check that the opening never grows with the counts."""
    for (counts, opening_m), (more, next_m) in pairwise(pairs):
        if not (counts < more and opening_m >= next_m):
            way = f"from {counts:g} to {more:g} counts"
            raise ValueError(f"the opening does not decrease {way}: {opening_m:.4g} to {next_m:.4g} m")
    return pairs


class FileInUse(Strict):
    """A calibration file: path, hash, creation date and verdict."""

    file: str
    sha256: str
    created: str
    verdict: str


class CameraInUse(Strict):
    """Camera calibration. matrix: nine numbers, row by row, px. distortion: five or eight, OpenCV's order.

    terms, covariance: uncertainty, row by row, as in `CameraUncertainty`; empty in sessions of versions that
    did not store it.
    """

    matrix: Annotated[tuple[float, ...], Field(min_length=9, max_length=9)]
    distortion: Annotated[tuple[float, ...], Field(min_length=5, max_length=8)]
    terms: Annotated[tuple[Term, ...], Field(max_length=12)] = ()
    covariance: tuple[float, ...] = ()

    @classmethod
    def of(cls, camera: CameraModel) -> Self:
        known = camera.uncertainty or CameraUncertainty()
        return cls(
            matrix=tuple(camera.matrix.ravel().tolist()),
            distortion=tuple(camera.distortion.tolist()),
            terms=known.terms,
            covariance=tuple(known.covariance.ravel().tolist()),
        )

    @model_validator(mode="after")
    def _is_a_covariance(self) -> Self:
        if len(self.covariance) != len(self.terms) ** 2:
            raise ValueError(
                f"a covariance of {len(self.terms)} terms cannot have {len(self.covariance)} numbers"
            )
        return self

    def camera_model(self, size_px: tuple[int, int]) -> CameraModel:
        """Return the camera for pictures of the bench file's size (checked when the file was found)."""
        count = len(self.terms)
        known = CameraUncertainty(self.terms, np.reshape(self.covariance, (count, count))) if count else None
        return CameraModel(size_px, np.reshape(self.matrix, (3, 3)), np.array(self.distortion), known)


class PlaceInUse(Strict):
    """`base_T_camera`: position in m, quaternion xyzw.

    turn_sigma_rad: one sigma of its orientation about the least certain axis; 0 if unknown.
    """

    position_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]
    turn_sigma_rad: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0

    @model_validator(mode="after")
    def _is_a_place(self) -> Self:
        # imported here: it loads scipy's rotations, which delay the start of most commands
        from calibration.poses import pose_fault

        fault = pose_fault(self.pose(), "base_T_camera")
        if fault is not None:
            raise ValueError(fault)
        return self

    def pose(self) -> Pose:
        return Pose(self.position_m, self.quaternion_xyzw)


class GelInUse(Strict):
    """The calibrated colours of a fingertip's gel, with which `slip` computes slopes: see `GelLook`.

    shape: rows and columns of its images. weights: (F, 3), row by row. noise: covariance of the channels,
    (3, 3), row by row, grey levels squared. The background is not stored: each lift has its own.
    """

    shape: tuple[Annotated[int, Field(ge=8, le=8192)], Annotated[int, Field(ge=8, le=8192)]]
    mm_per_px: tuple[Annotated[float, Field(gt=0.0, le=1.0)], Annotated[float, Field(gt=0.0, le=1.0)]]
    place_degree: Annotated[int, Field(ge=0, le=2)]
    by_background: bool
    shadows: bool
    weights: Annotated[tuple[float, ...], Field(max_length=600)]
    noise: Annotated[tuple[float, ...], Field(min_length=9, max_length=9)]

    @classmethod
    def of(cls, look: GelLook) -> Self:
        return cls(
            shape=look.shape,
            mm_per_px=look.mm_per_px,
            place_degree=look.place_degree,
            by_background=look.by_background,
            shadows=look.shadows,
            weights=tuple(look.weights.ravel().tolist()),
            noise=tuple(look.noise.colours.ravel().tolist()),
        )

    def look(self) -> GelLook:
        """Return the look, with a black background."""
        return GelLook(
            np.zeros((*self.shape, 3), np.float32),
            np.reshape(self.weights, (-1, 3)),
            self.place_degree,
            self.by_background,
            self.shadows,
            self.mm_per_px,
            CameraNoise.uncorrelated(np.reshape(self.noise, (3, 3))),
            None,
        )


class CalibrationsInUse(Section):
    """Calibrated values that replace the nominal ones of the bench file.

    files: by kind and serial. pixel_aspect, time_shift_s (added to a sensor's times): by serial.
    opening: pairs of counts and m while the fingers close, counts rising. gel: by serial, if the bench file
    names a calibration.
    """

    files: dict[str, FileInUse] = Field(default_factory=dict)
    camera: CameraInUse | None = None
    base_T_camera: PlaceInUse | None = None  # noqa: N815 - frame names keep their case
    pixel_aspect: dict[str, Aspect] = Field(default_factory=dict)
    time_shift_s: dict[str, TimeShift] = Field(default_factory=dict)
    opening: Annotated[tuple[tuple[Counts, Opening], ...], AfterValidator(_closing)] = ()
    gel: dict[str, GelInUse] = Field(default={})

    def joined(self, other: "CalibrationsInUse") -> "CalibrationsInUse":
        """Return the union; values of `other` take precedence."""
        pairs = {key: (value, getattr(other, key)) for key, value in self}
        return CalibrationsInUse(
            **{key: a | b if isinstance(a, dict) else b or a for key, (a, b) in pairs.items()}
        )
