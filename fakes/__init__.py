"""A bench made of variables: one simulated world and the devices that see and move it."""
