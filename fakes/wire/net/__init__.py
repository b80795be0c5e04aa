"""Sockets in threads, loopback addresses, and the side channel of running fakes."""
