"""The simulated devices behind the interfaces of `drivers`, in this process.

Imports the world, `fakes.gel` and `fakes.camera`, which draw it, and nothing of the wires.
"""
