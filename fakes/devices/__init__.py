"""Simulated devices in this process, which implement the interfaces of `drivers`."""
