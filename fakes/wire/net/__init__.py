"""Sockets in threads, loopback addresses, and the side channel of running fakes.

Imports nothing of the other fakes.
"""
