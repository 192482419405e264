"""Signatures of a folder's list of hashes, which a program of the user's makes and checks."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.scratch import scratch_folder
from dqforge.reports.operating_system import system
from dqforge.reports.run_folder import MANIFEST

_FILE = "{}"
_LARGEST = 1_000_000
_WITHIN_S = 60.0


def command_words(command: str, option: str) -> list[str]:
    """Words of a command as a shell reads them, of which none is started.

    Raises:
        InputError: A quote is open, or the file has no place in it.
    """
    try:
        words = shlex.split(command, posix=not system.WINDOWS)
    except ValueError as error:
        raise InputError(f"{option} {command!r}: {error}; close the quotation") from error
    if not any(_FILE in word for word in words[1:]) or not words[0]:
        raise InputError(
            f"{option} {command!r}: there is no {_FILE} for {MANIFEST}; write e.g. "
            f"{option} '{_EXAMPLES[option]}'"
        )
    return words


_EXAMPLES = {"--sign": "minisign -Sm {}", "--signature": "minisign -Vm {} -p key.pub"}


def signatures(command: str, manifest: bytes) -> dict[str, bytes]:
    """What a command makes of the list of hashes, by names in the folder: the files that lie
    beside it afterwards, whose names begin with its own.

    Raises:
        InputError: The command cannot be started, fails, changes the list or makes no such file.
    """
    option = "--sign"
    with scratch_folder() as folder:
        path = folder / MANIFEST
        path.write_bytes(manifest)
        _run(command, option, path)
        made = {
            each.name: read_regular_file(each, _LARGEST)
            for each in sorted(folder.glob(f"{MANIFEST}.*"))
        }
        if path.read_bytes() != manifest:
            raise InputError(f"{option} {command!r}: it changed {MANIFEST}; let it write beside it")
    if not made:
        raise InputError(
            f"{option} {command!r}: it wrote no {MANIFEST}.*; let it write the signature beside "
            f"the file {_FILE}"
        )
    return made


def check_signature(command: str, folder: Path) -> str:
    """Have a command check the signature of a folder's list of hashes; a line that says so.

    Raises:
        InputError: The command cannot be started, or fails.
    """
    option = "--signature"
    _run(command, option, folder / MANIFEST)
    return f"signature: {command_words(command, option)[0]} accepts that of {MANIFEST}"


def _run(command: str, option: str, path: Path) -> None:
    words = [word.replace(_FILE, str(path)) for word in command_words(command, option)]
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, timeout=_WITHIN_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"{option} {command!r}: it did not end within {_WITHIN_S:g} s; use a key or an agent "
            "that asks nothing"
        ) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{option} {command!r}: it cannot be started ({reason}); name a program of this machine"
        ) from error
    if done.returncode != 0:
        said = " ".join((done.stderr or done.stdout).decode("utf-8", "replace").split())[:200]
        raise InputError(
            f"{option} {command!r}: it ended with {done.returncode}{said and f': {said}'}"
        )
