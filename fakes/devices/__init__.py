"""Simulated devices in this process, which implement the interfaces of `drivers`.

Imports the world, and `fakes.gel` and `fakes.camera`, which render it; nothing of `fakes.wire`.
"""
