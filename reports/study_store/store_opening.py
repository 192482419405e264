"""The folder of a study: made, kept from other runs, gone on with, or refused for what it holds."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

from dqforge.machines.errors import InputError
from dqforge.reports.operating_system.folder_lock import flush_folder
from dqforge.reports.output.folder_swap import remove_empty_folders
from dqforge.reports.output.manifest import find_manifest, sha256
from dqforge.reports.run_folder import MANIFEST
from dqforge.reports.study_store.plain_study import INPUT, input_names
from dqforge.reports.study_store.store_files import (
    BESIDE,
    PARTS,
    WINNERS,
    keep_folder,
    own_files,
    part_files,
    read_whole,
    refuse_write,
    remove_leftovers,
)
from dqforge.reports.study_store.study_header import (
    STUDY_JSON,
    StudyHeader,
    differing_keys,
    header_from,
)

_NAMED = 4


def made_and_locked(folder: Path) -> int:
    """Make a folder with its folder of parts, and keep other runs out."""
    parts = folder / PARTS
    try:
        parts.mkdir(parents=True, exist_ok=True)
        if parts.is_symlink():
            raise InputError(f"{parts} is a link; take another -o")
        if not all(os.access(place, os.W_OK | os.X_OK) for place in (folder, parts)):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return keep_folder(folder)
    except OSError as error:
        raise InputError(
            f"cannot write the folder {folder}: {error.strerror or error}; take another -o"
        ) from error


def make_ready(folder: Path, header: StudyHeader, *, restart: bool, mixed: bool) -> None:
    """Hold what a folder has against a study, and take away what must go.

    Args:
        folder: Locked.
        header: The study that is asked.
        restart, mixed: As of `dqforge.reports.study_store.part_store.PartStore.open`.

    Raises:
        InputError: The folder holds something else.
    """
    old = held_study(folder)
    remove_leftovers(folder)
    if old is None:
        _refuse_strange(folder)
    elif restart:
        _take_away(folder, old)
    else:
        _refuse_other(folder, old, header, mixed=mixed)


def held_study(folder: Path) -> StudyHeader | None:
    """The study of a folder, None where there is none; raises `InputError` on anything else."""
    path = folder / STUDY_JSON
    try:
        return header_from(read_whole(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}; take another -o") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is not what dqforge wrote ({error}); take another -o") from error


def _refuse_other(folder: Path, old: StudyHeader, new: StudyHeader, *, mixed: bool) -> None:
    """Raise where what a folder holds cannot be gone on with."""
    then, now = old.computed_with, new.computed_with
    if then.get("dqforge") != now.get("dqforge"):
        raise InputError(
            f"{folder} was begun with dqforge {then.get('dqforge')}, this is {now.get('dqforge')}; "
            "take another -o, or --restart"
        )
    if old.digest != new.digest or new.count < old.count:
        raise InputError(_another(folder, old, new))
    other = _other_machine(old, new)
    if other and not mixed:
        raise InputError(
            f"{folder} was begun with {other}: bytes of further parts may differ in last digits; "
            "take another -o, --restart, or --mixed"
        )


def _refuse_strange(folder: Path) -> None:
    """Raise where a folder that holds no study holds what a study would write over."""
    if part_files(folder):
        raise InputError(f"{folder} holds parts without their {STUDY_JSON}; take another -o")
    there = [name for name in (MANIFEST, INPUT, *BESIDE) if os.path.lexists(folder / name)]
    if there:
        raise InputError(f"{folder} holds {there[0]}, which no study wrote; take another -o")


def _another(folder: Path, old: StudyHeader, new: StudyHeader) -> str:
    keys = differing_keys(old, new)
    count = len({*old.asked, *new.asked})
    named = ", ".join(keys[:_NAMED]) + (f" and {len(keys) - _NAMED} more" * (len(keys) > _NAMED))
    which = f"{len(keys)} of {count} keys differ: {named}" if keys else "its columns differ"
    return f"{folder} holds another study ({which}); take another -o, or --restart"


def _other_machine(old: StudyHeader, new: StudyHeader) -> str:
    """In what the libraries or the processor of an earlier run differ, empty where in nothing."""
    then, now = old.computed_with, new.computed_with
    for name in sorted({*then, *now}):
        if then.get(name) != now.get(name):
            return f"{name} {then.get(name, 'none')}, here {now.get(name, 'none')}"
    if old.created_by != new.created_by:
        return f"{old.created_by}, here {new.created_by}"
    features = sorted({*old.cpu_features} ^ {*new.cpu_features})
    where = "there" if features and features[0] in old.cpu_features else "here"
    return f"another processor ({features[0]} only {where})" if features else ""


def _take_away(folder: Path, header: StudyHeader) -> None:
    """Remove what a study wrote, its parts first: what is left of it at any time is a study."""
    names = (*BESIDE, *input_names(header.study))
    try:
        for path in own_files(folder, names):
            path.unlink(missing_ok=True)
        for winner in sorted((folder / WINNERS).glob("row-*")):
            _take_winner(winner)
        flush_folder(folder / PARTS)
    except OSError as error:
        refuse_write(folder, error)


def _take_winner(folder: Path) -> None:
    """Remove what `dqforge.reports.study_store.winners` wrote, as far as nobody changed it."""
    manifest = None if folder.is_symlink() else find_manifest(folder)
    if manifest is None:
        return
    for name, digest in manifest.files.items():
        path = folder / name
        if path.is_file() and not path.is_symlink() and sha256(path.read_bytes()) == digest:
            path.unlink()
    (folder / MANIFEST).unlink()
    remove_empty_folders(folder, {*manifest.files, MANIFEST})
    for empty in (folder, folder.parent):
        with suppress(OSError):
            empty.rmdir()
