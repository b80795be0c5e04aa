"""The one simulated world: where tool, fingers and object are, and how the object slips.

Imports `fakes.objects`; it knows no device and draws nothing.
"""
