"""Read files of one commit from a clone of a public repository, with git."""

import hashlib
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from drivers.errors import InputError


def read_verified(clone: Path, repository: str, commit: str, sha256: Mapping[str, str]) -> dict[str, bytes]:
    """Return the contents of files at a commit by path, each compared with its stored hash.

    clone: work tree or git directory. repository: owner and name on GitHub. commit: full hash. sha256: by
    path. Raises `InputError` without git, for another folder, a missing commit, a missing file, or a file
    that differs from its hash.
    """
    _require_commit(clone, repository, commit)
    files = {}
    for path, expected in sha256.items():
        files[path] = _git(clone, "cat-file", "blob", f"{commit}:{path}")
        found = hashlib.sha256(files[path]).hexdigest()
        if found != expected:
            raise InputError(
                f"{clone}: {path} at {commit[:8]} has the SHA-256 {found[:12]}..., the labelled file had "
                f"{expected[:12]}...: clone {_address(repository)} again"
            )
    return files


def _require_commit(clone: Path, repository: str, commit: str) -> None:
    wanted = f"give a clone: git clone {_address(repository)}"
    if not clone.is_dir():
        raise InputError(f"{clone}: there is no such folder: {wanted}")
    try:
        _git(clone, "rev-parse", "--git-dir")
    except InputError as error:
        raise InputError(f"{error}; {wanted}") from error
    try:
        _git(clone, "cat-file", "-e", f"{commit}^{{commit}}")
    except InputError as error:
        raise InputError(
            f"{clone}: has no commit {commit[:8]} of {repository}: if it is a shallow clone of it, run git "
            f"-C {clone} fetch --unshallow, if an older one, git -C {clone} fetch; otherwise {wanted}"
        ) from error


def _address(repository: str) -> str:
    return f"https://github.com/{repository}"


def _git(clone: Path, *arguments: str) -> bytes:
    """Return the output of a git command. Raises `InputError` with git's reason."""
    program = shutil.which("git")
    if program is None:
        raise InputError("git was not found on this computer: install it, for example with apt install git")
    # Variables such as GIT_DIR would select another repository than the folder that was given.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    command = [program, "-C", str(clone), *arguments]
    done = subprocess.run(command, capture_output=True, check=False, env=environment)  # noqa: S603 - git
    if done.returncode != 0:
        reason = done.stderr.decode(errors="replace").strip().removeprefix("fatal: ")
        raise InputError(f"{clone}: git cannot read it ({reason})")
    return done.stdout
