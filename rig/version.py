"""The version of the slip rig, also in a source tree that is not installed, and the processor it runs on."""

import functools
import platform
from pathlib import Path

VERSION = "1.0.0"


@functools.cache
def version_text() -> str:
    """Return the version, in a checkout with its commit, such as "1.0.0 (commit 1f2e3d4c, with changes)".

    Everything that is stored names it: sessions, exports, clips, benchmarks and calibrations.
    """
    import subprocess

    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return VERSION
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=8", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)  # noqa: S603
    except (OSError, subprocess.SubprocessError):
        return VERSION
    return f"{VERSION} (commit {done.stdout.strip().replace('-dirty', ', with changes')})"


def processor() -> str:
    """Return the name of this computer's processor, such as "AMD EPYC 7763, family 25 model 1".

    Virtual machines often hide the name, but not the numbers of family and model.
    """
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    of = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    if "model name" not in of:
        return platform.processor() or platform.machine()
    return f"{of['model name']}, family {of.get('cpu family')} model {of.get('model')}"
