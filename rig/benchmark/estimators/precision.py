"""Single against double precision in the alignment, on the same gradients.

Compared are the normal equations: template, Jacobian, residuals, weights and both sides of the
6 x 6 system in float32, as the estimator has them, against float64. The resampling of the frame stays
float32 in both, as OpenCV has no other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fakes.studio.clips import Clip, Scene, render_clip
from rig.tactile.contact.gate import ContactGate
from rig.tactile.contact.relative import RelativeDifference
from rig.tactile.slip.gradient import learn_map
from rig.tactile.slip.height import Gradient
from rig.tactile.slip.keyframe import Keyframe, make_keyframe
from rig.tactile.slip.registration import align
from rig.tactile.slip.sampling import GradientField

SIZE_PX = (60, 80)
BLUR_PX = 0.7


@dataclass(frozen=True, slots=True)
class Precision:
    """Largest and median difference of the angle in degrees over `frames` alignments.

    condition: the largest condition number of the keyframes' normal matrices in float64, scaled to
    a unit diagonal.
    """

    largest_deg: float
    median_deg: float
    condition: float
    frames: int


def compare_precision(contacts: Sequence[str], seed: int = 0) -> Precision:
    """Align each frame of a turn to its clip's first one, in both precisions, from the same start."""
    gaps: list[float] = []
    conditions: list[float] = []
    for contact in contacts:
        clip = render_clip(Scene(contact, angle_deg=20.0, seed=seed))
        fields = _fields(clip)
        if not fields:
            continue
        single = make_keyframe(*fields[0])
        if single is None:
            continue
        double = _doubled(single)
        conditions.append(_condition(double))
        gaps += _gaps(single, double, fields[1:])
    if not gaps:
        return Precision(0.0, 0.0, 0.0, 0)
    return Precision(max(gaps), float(np.median(gaps)), max(conditions), len(gaps))


def _gaps(single: Keyframe, double: Keyframe, fields: Sequence[tuple[Gradient, np.ndarray]]) -> list[float]:
    angle, shift = 0.0, 0j
    gaps = []
    for gradient, mask in fields:
        field = GradientField(gradient, mask)
        a, b = align(single, field, angle, shift), align(double, field, angle, shift)
        gaps.append(float(np.degrees(abs(a.angle_rad - b.angle_rad))))
        angle, shift = a.angle_rad, a.shift_px
    return gaps


def _doubled(key: Keyframe) -> Keyframe:
    return replace(key, template=key.template.astype(np.float64), jacobian=key.jacobian.astype(np.float64))  # type: ignore[arg-type]


def _condition(key: Keyframe) -> float:
    rows = key.jacobian.reshape(len(key.jacobian), -1)
    normal = rows @ rows.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-30))
    return float(np.linalg.cond(normal * np.outer(scale, scale)))


def _fields(clip: Clip) -> list[tuple[Gradient, np.ndarray]]:
    """Gradient and contact mask of a clip's frames, by the map of the last frame before it moves."""
    light, gate = RelativeDifference(clip.background, SIZE_PX), ContactGate()
    seen = []
    first = max(i for i, t in enumerate(clip.time_ns) if t < clip.moves_ns)
    for frame in clip.frames[first:]:
        difference = cv2.GaussianBlur(light.of(light.reduced(frame)), (0, 0), BLUR_PX).astype(np.float32)
        region = gate.find(difference)
        if region is not None:
            seen.append((difference, region.mask))
    learnt = learn_map(*seen[0]) if seen else None
    return [] if learnt is None else [(learnt.apply(difference), mask) for difference, mask in seen]
