"""What the bench's hardware can do: interfaces, values, errors and the clock.

Everything above this package (protocols, fakes, calibration, rig) speaks in these terms.
Concrete drivers, when installed here, are named by `rig.assembly` alone.
"""
