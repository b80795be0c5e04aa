"""Numbers that turn pixels and counts into metres and radians, with their uncertainty."""
