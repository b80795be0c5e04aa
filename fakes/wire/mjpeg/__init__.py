"""Simulated sensors as Motion JPEG over HTTP; `server.py` serves one."""
