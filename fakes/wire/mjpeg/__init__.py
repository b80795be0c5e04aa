"""Simulated sensors as Motion JPEG over HTTP; `server.py` serves one.

Imports `fakes.wire.net`.
"""
