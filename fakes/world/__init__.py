"""The simulated world: the state of tool, fingers and object, and the dynamics of slip.

Imports `fakes.objects`, but no simulated device; it renders nothing.
"""
