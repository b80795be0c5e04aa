"""The version of the slip rig, also in a source tree that is not installed, and the processor it runs on."""

import platform
from pathlib import Path

VERSION = "1.0.0"


def version_text() -> str:
    """Return the version, with the commit of a checkout, such as "1.0.0 (commit 1f2e3d4c)"."""
    import subprocess

    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return VERSION
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=8", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)  # noqa: S603
    except (OSError, subprocess.SubprocessError):
        return VERSION
    return f"{VERSION} (commit {done.stdout.strip()})"


def processor() -> str:
    """Return the name of this computer's processor, such as "AMD EPYC 7763 64-Core Processor"."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
