"""The simulated devices, in process, behind the interfaces of `drivers`.

Imports the world and what draws it.
"""
