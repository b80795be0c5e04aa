"""A simulated UR controller behind its own ports: RTDE, script, dashboard; `controller.py` serves it."""
