"""Make further versions of labelled clips: mirrored left-right, flipped top-bottom, and reversed in time.

The labels are transformed with the frames. An estimator that is overfitted to the objects, the light or the
direction of rotation of the clips has larger errors on these versions.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, unknown_name
from drivers.types import Image
from rig.benchmark.clips.labelled import ClipLabel, ClipVersion, ContactSpan, LabelledClip
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime

_IMAGE_AXIS = {ClipVersion.MIRROR: 1, ClipVersion.FLIP: 0}


def chosen_versions(text: str | None) -> tuple[ClipVersion, ...]:
    """Return the plain version and those of a comma-separated list.

    Raises `InputError` for an unknown name.
    """
    versions = [ClipVersion.PLAIN]
    for name in (part.strip() for part in (text or "").split(",")):
        if name and name not in [*ClipVersion]:
            raise InputError(unknown_name("version", name, [*ClipVersion][1:]))
        if name and ClipVersion(name) not in versions:
            versions.append(ClipVersion(name))
    return tuple(versions)


def augmented(clips: Sequence[LabelledClip], versions: Sequence[ClipVersion]) -> list[LabelledClip]:
    """Return each clip in each version, version by version."""
    return [clip_version(clip, version) for version in versions for clip in clips]


def clip_version(clip: LabelledClip, version: ClipVersion) -> LabelledClip:
    """Return a clip in a version, with the version in its name; the plain version is the clip itself."""
    if version is ClipVersion.PLAIN:
        return clip
    found = _backwards(clip) if version is ClipVersion.REVERSE else _mirrored(clip, _IMAGE_AXIS[version])
    return replace(found, name=f"{clip.name} ({version})", version=version)


def _mirrored(clip: LabelledClip, axis: int) -> LabelledClip:
    """Return a clip with frames and background mirrored along an image axis, which negates all angles."""

    def read() -> Iterator[TimedFrame]:
        for frame in clip.series.read():
            image = frame.image
            yield replace(frame, image=None if image is None else _flipped(image, axis))

    return replace(
        clip,
        series=FrameSeries(clip.series.name, read, clip.series.notes),
        background=_flipped(clip.background, axis),
        labels=tuple(replace(label, angle_deg=-label.angle_deg) for label in clip.labels),
    )


def _flipped(image: Image, axis: int) -> Image:
    return np.ascontiguousarray(np.flip(image, axis))


def _backwards(clip: LabelledClip) -> LabelledClip:
    """Return a clip that runs backwards from its last labelled frame, which becomes the reference.

    The background is unchanged. The former reference becomes a label. The intervals between frames keep their
    lengths, in reversed order.
    """
    reference = ClipLabel(clip.reference_frame, 0.0, 0.0)
    *earlier, last = sorted([*clip.labels, reference], key=lambda label: label.frame)
    surest_deg = min(label.sigma_deg for label in clip.labels)

    def read() -> Iterator[TimedFrame]:
        frames = [frame for number, frame in enumerate(clip.series.read()) if number <= last.frame]
        first_ns, last_ns = frames[0].time.time_ns, frames[-1].time.time_ns
        for frame in reversed(frames):
            time_ns = first_ns + last_ns - frame.time.time_ns
            yield replace(frame, time=FrameTime(f"{time_ns / NS_PER_S:.6f}", time_ns))

    def relative(label: ClipLabel) -> ClipLabel:
        # The variance of a label is the sum of those of two lines drawn by hand, one of them at the
        # reference. The line at the reference cancels in the difference of two labels. Its variance is
        # assumed to be half of the smallest variance of a label.
        common = 0.0 if reference in (label, last) else surest_deg**2
        variance = label.sigma_deg**2 + last.sigma_deg**2 - common
        return ClipLabel(last.frame - label.frame, label.angle_deg - last.angle_deg, math.sqrt(variance))

    spans = [
        ContactSpan(last.frame - min(span.last, last.frame), last.frame - span.first, span.contact)
        for span in clip.contacts
        if span.first <= last.frame
    ]
    return replace(
        clip,
        series=FrameSeries(clip.series.name, read, clip.series.notes),
        reference_frame=0,
        labels=tuple(relative(label) for label in reversed(earlier)),
        contacts=tuple(reversed(spans)),
    )
