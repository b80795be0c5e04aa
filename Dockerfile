# The rig with the simulated bench; for a bench computer see compose.yaml and docs/simulated.md.
FROM python:3.12-slim-bookworm

# libudev finds sensors by serial; everything else comes in wheels.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libudev1 \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/slip-rig
COPY pyproject.toml requirements.lock README.md LICENSE ./
COPY calibration calibration
COPY drivers drivers
COPY fakes fakes
COPY protocols protocols
COPY rig rig
RUN pip install --no-cache-dir -c requirements.lock ".[bench]"

# Not root: limits and file modes are to mean something.
RUN useradd --create-home --groups video,dialout rig && mkdir /bench && chown rig /bench
USER rig
# The estimator's loops, compiled where this user may keep them.
RUN python -c "from rig.tactile.slip.all_loops import compile_all; compile_all()"
WORKDIR /bench

STOPSIGNAL SIGINT
ENTRYPOINT ["rig"]
CMD ["trial", "--lifts", "5"]
