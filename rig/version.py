"""The version of the slip rig, also in a source tree that is not installed."""

VERSION = "1.0.0"
