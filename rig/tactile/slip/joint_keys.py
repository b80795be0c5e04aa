"""The keyframes of a contact to which later frames are aligned jointly, and their common colour map.

A keyframe is rich if its texture has much energy; a keyframe of a small contact is poor. The richest
keyframes are kept as long as the contact lasts, so that errors do not add up from one to the next.
"""

from dataclasses import dataclass, replace

from drivers.types import Image
from rig.tactile.slip.channel import MOST_KEYS, JointKey
from rig.tactile.slip.gradient import Learn, LearntGradientMap, learn_map
from rig.tactile.slip.height import Field
from rig.tactile.slip.keyframe import make_keyframe
from rig.tactile.slip.keys import ContactPose, Key
from rig.tactile.slip.parameters import JOINT
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField, make_texture_key, richness


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RichKeyframe(Key):
    """A keyframe with its source data, so that it can be computed again with another colour map.

    difference: (h, w, 3). mask: (h, w) uint8, 1 in the contact. richness: root energy of its texture.
    """

    difference: Field
    mask: Image
    richness: float

    def with_map(self, learnt: LearntGradientMap) -> "RichKeyframe | None":
        """Return this keyframe computed with another colour map; None if it then has too few points."""
        frame = make_keyframe(learnt.apply(self.difference), self.mask)
        if frame is None:
            return None
        moved = frame.center_px - self.frame.center_px
        return replace(self, frame=frame, texture=self.texture and self.texture.counted_from(moved))


class RichKeyframes:
    """The keyframes of one contact; empty before the first. learn: returns the map of a keyframe."""

    def __init__(self, learn: Learn = learn_map) -> None:
        self._keys: list[RichKeyframe] = []
        self._learn = learn
        self.map: LearntGradientMap | None = None
        """The map learnt from the richest keyframe."""

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def richest(self) -> float:
        """The richness of the richest keyframe, 0 without any."""
        return max((key.richness for key in self._keys), default=0.0)

    def facing(self, field: GradientField, texture: TextureField) -> list[JointKey]:
        """Return the keyframes that are rich enough, with a frame to align to them, weighted by richness."""
        best = self.richest
        rich = (key for key in self._keys if key.richness >= JOINT.least_richness * best)
        facing = (key.facing(field, texture, key.richness / best, fine=True) for key in rich)
        return [key for key in facing if key is not None]

    def wants(self, texture: TextureField, mask: Image, angle_rad: float) -> bool:
        """Whether a frame at an angle should become a keyframe."""
        nearest = min(abs(key.pose.angle_rad - angle_rad) for key in self._keys)
        return nearest > JOINT.further_rad or richness(texture, mask) > JOINT.richer * self.richest

    def add(
        self,
        difference: Field,
        texture: TextureField,
        mask: Image,
        angle_rad: float,
        point_px: complex | None,
    ) -> complex | None:
        """Add a frame as a keyframe; return the tracked point, or None if the frame has too few points.

        angle_rad, point_px: pose of the contact in it; the point of the first keyframe is its center.
        """
        rich = richness(texture, mask)
        learnt = self._learn(difference, mask) if rich > self.richest else None
        used = learnt or self.map
        frame = None if used is None else make_keyframe(used.apply(difference), mask)
        fine = None if frame is None else make_texture_key(texture, mask, frame.center_px)
        if used is None or frame is None or fine is None:
            return None
        if learnt is not None:
            again = (key.with_map(learnt) for key in self._keys)
            self._keys = [key for key in again if key is not None]
        self.map = used
        point = frame.center_px if point_px is None else point_px
        pose = ContactPose(angle_rad, point)
        key = RichKeyframe(frame, fine, pose, 0.0, difference=difference, mask=mask, richness=rich)
        self._keys.append(key)
        if len(self._keys) > MOST_KEYS:
            self._keys.remove(min(self._keys[:-1], key=lambda key: key.richness))
        return point
