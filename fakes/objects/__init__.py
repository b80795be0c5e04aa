"""The simulated objects: catalogue, shapes, textures, and the surfaces that fingers touch."""
