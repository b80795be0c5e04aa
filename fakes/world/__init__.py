"""The simulated world: the state of tool, fingers and object, and the dynamics of slip."""
