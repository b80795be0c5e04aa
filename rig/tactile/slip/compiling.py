"""Start the process that compiles the loops of `slip`, beside everything else that starts.

Importing this module does not import Numba, so that a command can begin to compile at once. All other
processes wait for this one, and load the loops from the cache (`rig.tactile.slip.all_loops`).
"""

import fcntl
import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

from drivers.children import python_command, signals_of_terminal_held
from drivers.progress import begin_work

COMPILING_S = 12
"""Duration of the compilation on two idle cores, s: 12.3 and 12.5 (docs/measurements.md)."""
SOURCES = ("compiled.py", "all_loops.py", "loops.py", "pixels.py")
"""The files beside this one that determine the compiled loops."""
LOCK, ALL_COMPILED = "compiling.lock", "all_compiled"
"""Files in the cache folder: locked while a process compiles; exists if all loops are in the folder."""
_PROCESSOR = ("model name", "flags", "Features", "CPU part")
"""Keys of /proc/cpuinfo. Other values need another cache: Numba compiles for the processor's features."""
_child: "subprocess.Popen[bytes] | None" = None
"""The process that compiles. It ends when this process has ended, which closes its standard input."""
_announced = False


@cache
def cache_folder() -> Path | None:
    """Return the folder of the compiled loops; None if no folder is writable.

    It is in NUMBA_CACHE_DIR, in the user's cache, or beside this file. Its name depends on everything that
    the compiled loops depend on, and not on the place of the installation.
    """
    here, numba = Path(__file__).parent, find_spec("numba")
    content = sha256(repr((sys.version_info[:2], _processor(), _settings())).encode())
    for file in (*map(here.joinpath, SOURCES), Path(str(numba and numba.origin)).with_name("_version.py")):
        content.update(file.read_bytes())
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "numba")
    for parent in (Path(os.environ.get("NUMBA_CACHE_DIR") or user), here / "__pycache__"):
        folder = parent / f"slip_rig_{content.hexdigest()[:16]}"
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


def _processor() -> list[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []
    return sorted({line for line in lines if line.startswith(_PROCESSOR)})


def _settings() -> list[tuple[str, str]]:
    """Numba's settings, some of which change the compiled loops."""
    return sorted((k, v) for k, v in os.environ.items() if k.startswith("NUMBA_") and k != "NUMBA_CACHE_DIR")


def begin_compiling(announce: Callable[[str], None] = begin_work) -> None:
    """Start the process that compiles the loops, unless they are in the cache or another process compiles.

    announce: shows a line about the work, once per process, and not in workers. Without a cache nothing is
    started: each process compiles for itself when it needs the loops.
    """
    global _child, _announced
    folder, work = cache_folder(), f"compiling the estimator, about {COMPILING_S} s"
    if folder is None:
        work += ", each time: set NUMBA_CACHE_DIR to a folder that can be written"
    elif (folder / ALL_COMPILED).exists():
        return
    else:
        work += " if two cores are idle, once per version"
        try:
            # The process inherits the lock, which is released as soon as it has ended, in whatever way.
            with (folder / LOCK).open("w") as lock, signals_of_terminal_held():
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                code = "from rig.tactile.slip.all_loops import compile_into_cache; compile_into_cache()"
                quiet = subprocess.DEVNULL
                _child = subprocess.Popen(  # noqa: S603
                    python_command("-c", code),
                    stdin=subprocess.PIPE,
                    stdout=quiet,
                    stderr=quiet,
                    pass_fds=[lock.fileno()],
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a fork copies no threads
                )
        except OSError:  # another process compiles, or none can be started
            return
    if not _announced and multiprocessing.parent_process() is None:
        _announced = True
        announce(work)


def is_compiling() -> bool:
    """Whether a process that this one has started compiles the loops."""
    return _child is not None and _child.poll() is None


def wait_until_compiled(folder: Path) -> bool:
    """Wait while a process compiles into the folder; return whether all loops are there."""
    if not (folder / ALL_COMPILED).exists():
        with suppress(OSError), (folder / LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
    return (folder / ALL_COMPILED).exists()
