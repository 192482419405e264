"""Output folders: wholly old or wholly new, with a list of hashes, and nothing
lost that others put there.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.design.reading import MAX_FILE_BYTES
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.reports.operating_system.folder_lock import FolderTakenError, lock_folder
from dqforge.reports.output import folder_swap
from dqforge.reports.output.manifest import (
    Manifest,
    Part,
    find_manifest,
    part_of,
    sha256,
    to_bytes,
)
from dqforge.reports.run_folder import MANIFEST, input_files

RUN, SIMULATION, FIGURES = "run", "simulation", "figures"


_LONGEST_WAIT_S = 60.0


def _refusal(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"cannot write the folder {folder}: {error.strerror or error}; choose another one with -o"
    )


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other runs from the folder above; its lock goes with the process, however that ends."""
    try:
        handle = _lock(folder)
    except OSError:
        # a folder above that cannot be read cannot be written either: the files go in from inside
        yield
        return
    try:
        yield
    finally:
        os.close(handle)


def _lock(folder: Path) -> int:
    end = time.monotonic() + _LONGEST_WAIT_S
    while True:
        try:
            return lock_folder(folder.parent)
        except FolderTakenError as error:
            if time.monotonic() > end:
                raise InputError(
                    f"another run is writing beside {folder}; wait for it, or choose another -o"
                ) from error
            time.sleep(0.01)


def _intact(folder: Path, part: Part) -> bool:
    return all((folder / name).is_file() for name in part.files)


def _belongs(part: Part, digest: str) -> bool:
    """Whether what an earlier command wrote is of this design and of this version."""
    return part.digest == digest and part.version == __version__


def refuse_other_design(folder: Path, digest: str, prefix: str) -> None:
    """Refuse to put samples of one design beside the headers of another.

    Raises
    ------
    InputError
        The folder holds what a run of another design, or of another version, wrote.
    """
    found = find_manifest(folder)
    if found is not None and RUN in found.parts and not _belongs(found.parts[RUN], digest):
        raise InputError(
            f"{folder} holds the headers of another design or version; write the samples of "
            f"{prefix} elsewhere with -o, or run this design into it first"
        )


def _unchanged(path: Path, digest: str) -> bool:
    try:
        return not path.is_symlink() and sha256(read_regular_file(path, MAX_FILE_BYTES)) == digest
    except InputError:
        return False


def _check_places(folder: Path, names: Mapping[str, bytes]) -> None:
    """Refuse what would have to replace a folder, or lie below a file, before anything is
    written.
    """
    for name in names:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            raise InputError(f"cannot write {path}: it is a folder; choose another folder with -o")
        for above in path.parents:
            if above == folder:
                break
            if os.path.lexists(above) and (above.is_symlink() or not above.is_dir()):
                raise InputError(
                    f"cannot write {path}: {above.name} is no folder; choose another folder with -o"
                )


def write_output(
    folder: Path, part: str, contents: Mapping[str, bytes], design: Design | None = None
) -> list[Path]:
    """Put the files of a command into a folder, all at once.

    What the same command wrote there before goes away, and what other commands wrote if it is of
    another design or version; files that dqforge did not write, or that were changed since, stay
    unless they have the name of a new one.

    Parameters
    ----------
    folder:
        Made if missing.
    part:
        `RUN`, `SIMULATION` or `FIGURES`.
    contents:
        Files by name.
    design:
        What they were made from; it is put into the folder as well.

    Returns
    -------
    list[Path]
        Paths of ``contents``.

    Raises
    ------
    InputError
        The folder cannot be written; it is as it was.
    """
    place = Path(os.path.realpath(folder))
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.exists() and not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if place.is_dir() and not os.access(place, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        with _alone(place):
            _write(place, part, contents, design)
    except OSError as error:
        raise _refusal(folder, error) from error
    return [folder / name for name in contents]


def _clear_up(place: Path) -> None:
    """Finish or remove what killed runs left."""
    if (place / folder_swap.PENDING / MANIFEST).is_file():
        folder_swap.finish_pending(place, MANIFEST)
    for sibling in folder_swap.siblings(place):
        left = find_manifest(sibling)
        folder_swap.clear_sibling(sibling, place, None if left is None else {*left.files, MANIFEST})


def _write(place: Path, part: str, contents: Mapping[str, bytes], design: Design | None) -> None:
    digest = "" if design is None else design.digest
    if part == SIMULATION and design is not None:
        refuse_other_design(place, digest, design.export.prefix)
    _clear_up(place)
    old = find_manifest(place) or Manifest({})
    given = input_files(None if design is None else design.given)
    kept = {
        name: other
        for name, other in old.parts.items()
        if name != part
        and (FIGURES in {name, part} or _belongs(other, digest))
        and _intact(place, other)
    }
    mine = part_of(digest, {**contents, **given})
    others = {name: replace(other, files=_without(other, mine)) for name, other in kept.items()}
    manifest = Manifest({**others, part: mine})
    files = {**given, **contents, MANIFEST: to_bytes(manifest)}
    _check_places(place, files)
    gone = [
        name
        for name in old.files
        if name not in manifest.files and _unchanged(place / name, old.files[name])
    ]
    folder_swap.replace_content(place, files, {*old.files, MANIFEST}, gone, MANIFEST)


def _without(other: Part, mine: Part) -> dict[str, str]:
    """Files of another part that this one does not write anew."""
    return {name: digest for name, digest in other.files.items() if name not in mine.files}
