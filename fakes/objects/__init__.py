"""The simulated objects: catalogue, shapes, textures, and the surfaces that fingers touch.

Imports nothing of the other fakes.
"""
