"""Output folders: wholly old or wholly new, with a list of hashes, and nothing
lost that others put there.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import json
import os
import shutil
import stat
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from dqforge import __version__
from dqforge.machines.design.design import MAX_FILE_BYTES, Design
from dqforge.machines.errors import InputError, WritingError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system import system
from dqforge.reports.operating_system.host_compiler import (
    alone,
    flush_folder,
)
from dqforge.reports.operating_system.packages import computed_with
from dqforge.reports.operating_system.system import undisturbed
from dqforge.reports.output.signatures import signatures
from dqforge.reports.pages.answer import (
    LARGEST_JSON,
    OUT,
    beside,
    left_beside,
    read_output,
    write_atomically,
)
from dqforge.reports.pages.templating import strict_json
from dqforge.reports.run_folder import INPUT, MANIFEST, RESULT, input_files

RUN, SIMULATION, FIRMWARE = "run", "simulation", "firmware"
ESTIMATORS, FIGURES = "estimators", "figures"

# What writes each part of a folder.
COMMANDS = {
    RUN: "run",
    SIMULATION: "simulate",
    FIRMWARE: "export --for",
    ESTIMATORS: "estimators",
    FIGURES: "reproduce",
}

COMMAND = "command"  # Option of a part `RUN`: run or export.

# Option of a part `RUN`: the standards in which its headers were compiled and compared.
VERIFIED = "verified"

# Options of a part `FIRMWARE`: whose files, and the file whose other fields were kept.
FIRMWARES, EXISTING = "for", "into"
SWITCHED = "switched"  # Option of a part `SIMULATION` whose every switching instant was simulated.


@dataclass(frozen=True, slots=True)
class Written:
    """What became of a folder, by names in it.

    ``paths`` are those of the contents. ``replaced`` lay there with other bytes, ``removed`` an
    earlier command of the same kind wrote; ``kept`` another command made of the same design as it
    was before.
    """

    paths: list[Path]
    replaced: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()


def default_folder(design: Design) -> Path:
    """Where the files of a design go if nobody says."""
    return Path(OUT) / design.export.prefix


def input_root(part: str) -> str:
    """Folder of what a part was made from: none writes that of another one."""
    return INPUT if part == RUN else f"{INPUT}/{part}"


def _refusal(folder: Path, error: OSError) -> InputError:
    return WritingError(
        f"cannot write the folder {folder}: {error.strerror or error}; choose another one with -o"
    )


def _is_there(folder: Path, part: Part) -> bool:
    return any((folder / name).is_file() for name in part.files)


def named_in_folder(design: Design | None) -> str:
    """The design as a folder knows it: another state of it has the same name and prefix."""
    return "" if design is None else f"{design.name} ({design.export.prefix})"


def _refuse_foreign(folder: Path, old: Manifest, design: Design | None) -> None:
    """Refuse to write over what another design made."""
    mine = named_in_folder(design)
    for part in old.parts.values():
        if mine and part.design and part.design != mine and _is_there(folder, part):
            raise WritingError(
                f"{folder} holds what dqforge made of {part.design}, this is {mine}; choose "
                "another folder with -o, or set another export.prefix"
            )


def _belongs(part: Part, digest: str) -> bool:
    """Whether what an earlier command wrote is of this design and of this version."""
    return part.digest == digest and part.version == __version__


def refuse_other_design(folder: Path, digest: str, prefix: str) -> None:
    """Refuse to put other files of one design beside the headers of another.

    Raises:
        InputError: The folder holds what a run of another design, or of another version, wrote.
    """
    found = find_manifest(folder)
    if found is not None and RUN in found.parts and not _belongs(found.parts[RUN], digest):
        raise WritingError(
            f"{folder} holds the headers of another design or version; write the files of "
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
            raise WritingError(
                f"cannot write {path}: it is a folder; choose another folder with -o"
            )
        for above in path.parents:
            if above == folder:
                break
            if os.path.lexists(above) and (above.is_symlink() or not above.is_dir()):
                raise WritingError(
                    f"cannot write {path}: {above.name} is no folder; choose another folder with -o"
                )


def put_output(
    folder: Path,
    part: str,
    contents: Mapping[str, bytes],
    design: Design | None = None,
    *,
    options: Mapping[str, str] | None = None,
    given: Mapping[str, bytes] | None = None,
    sign: str | None = None,
) -> Written:
    """Put the files of a command into a folder, all at once.

    What the same command wrote there of the same design goes away. What other commands wrote stays,
    as do files that dqforge did not write, or that were changed since, unless they have the name of
    a new one. `dqforge run` and `export` are one command; what a run wrote stays behind an export
    of the same design.

    Args:
        folder: Made if missing.
        part: One of `dqforge.reports.run_folder`.
        contents: Files by name.
        design: What they were made from; it is put into the folder as well.
        options, given: As of `dqforge.reports.pages.answer.Files`; what was given lies beside the
            design.
        sign: Command that signs the list of hashes (`dqforge.reports.output.signatures`).

    Raises:
        InputError: The folder cannot be written, or holds what another design, or another command
            under the same name, made, or the command that signs fails; it is as it was.
    """
    place = Path(os.path.realpath(folder))
    inputs = input_files(None if design is None else design.given, input_root(part))
    inputs |= {f"{input_root(part)}/{name}": content for name, content in (given or {}).items()}
    try:
        _require_writable(place)
        # a folder above that cannot be read cannot be written either: the files go in from inside
        with alone(place), undisturbed():
            _clear_up(place)
            old = find_manifest(place) or Manifest({})
            _refuse_foreign(folder, old, design)
            if part != RUN and design is not None:
                refuse_other_design(folder, design.digest, design.export.prefix)
            digest = "" if design is None else design.digest
            mine = part_of(digest, {**contents, **inputs}, named_in_folder(design), options)
            done = _write(folder, place, part, old, mine, contents, inputs, sign)
    except OSError as error:
        raise _refusal(folder, error) from error
    return done


def write_output(
    folder: Path, part: str, contents: Mapping[str, bytes], design: Design | None = None
) -> list[Path]:
    """As `put_output`; paths of ``contents``."""
    return put_output(folder, part, contents, design).paths


def put_files(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    """Put files into a folder all at once, which is made if missing; their paths.

    What lies there stays, unless it has the name of one of them.

    Raises:
        InputError: The folder cannot be written; it is as it was.
    """
    place, paths = Path(os.path.realpath(folder)), [folder / name for name in contents]
    try:
        _require_writable(place)
        if len(paths) == 1 and place.is_dir():
            _check_places(folder, contents)
            write_atomically(paths[0], contents.values())
            return paths
        with alone(place), undisturbed():
            *_, last = contents
            _clear_up(place, last)
            _check_places(folder, contents)
            if place.is_dir():
                _replace_inside(place, contents, (), last)
            else:
                _swap(place, contents, (), ())
    except OSError as error:
        raise _refusal(folder, error) from error
    return paths


def _require_writable(place: Path) -> None:
    """Raise OSError unless files can be put into a folder; what is above it is made."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if place.exists() and not place.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    if place.is_dir() and not os.access(place, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _clear_up(place: Path, marker: str = MANIFEST) -> None:
    """Finish or remove what killed runs left."""
    if (place / PENDING).is_dir():
        old, new = find_manifest(place), find_manifest(place / PENDING)
        if old is not None and new is not None:
            _remove(place, old.files.keys() - new.files.keys())
        finish_pending(place, marker)
    shutil.rmtree(place / _STAGED, ignore_errors=True)
    for sibling in siblings(place):
        left = find_manifest(sibling)
        clear_sibling(sibling, place, None if left is None else {*left.files, MANIFEST})


def _write(
    folder: Path,
    place: Path,
    part: str,
    old: Manifest,
    mine: Part,
    contents: Mapping[str, bytes],
    inputs: Mapping[str, bytes],
    sign: str | None,
) -> Written:
    others = {name: other for name, other in old.parts.items() if name != part}
    if part == RUN:
        others = _without(others, mine)
    else:
        _refuse_names(folder, others, mine)
    before = old.parts.get(part)
    if before is not None and _holds_export(place, before, mine):
        mine = before
        contents = {name: content for name, content in contents.items() if name != RESULT}
    manifest = Manifest({**others, part: mine})
    listed = to_bytes(manifest)
    signed = {} if sign is None else signatures(sign, listed)
    files = {**inputs, **contents, **signed, MANIFEST: listed}
    _check_places(place, files)
    gone = [
        name
        for name in old.files
        if name not in manifest.files and _unchanged(place / name, old.files[name])
    ]
    replaced = [
        name
        for name, content in contents.items()
        if os.path.lexists(place / name) and not _unchanged(place / name, sha256(content))
    ]
    replace_content(place, files, {*old.files, MANIFEST}, gone, MANIFEST)
    stale = [
        name
        for other in others.values()
        for name in other.files
        if other.design and other.digest != mine.digest and not _is_input(name)
    ]
    removed = [name for name in gone if not _is_input(name)]
    paths = [folder / name for name in contents]
    return Written(paths, tuple(replaced), tuple(removed), tuple(sorted(stale)))


def _is_input(name: str) -> bool:
    return name.startswith(f"{INPUT}/")


def _holds_export(place: Path, before: Part, mine: Part) -> bool:
    """Whether a run already wrote what an export is about to write, and more."""
    if mine.options.get(COMMAND) != "export" or before.options.get(COMMAND) != "run":
        return False
    same = all(before.files.get(name) == mine.files[name] for name in mine.files if name != RESULT)
    return (
        same
        and _belongs(before, mine.digest)
        and all(_unchanged(place / name, digest) for name, digest in before.files.items())
    )


def _refuse_names(folder: Path, others: Mapping[str, Part], mine: Part) -> None:
    """Refuse to replace a file of another command by another content."""
    for part, other in others.items():
        for name, digest in mine.files.items():
            if other.files.get(name, digest) != digest and (folder / name).is_file():
                raise WritingError(
                    f"{folder / name} is what 'dqforge {COMMANDS[part]}' wrote, with another "
                    "content; choose another folder with -o"
                )


def _without(others: Mapping[str, Part], mine: Part) -> dict[str, Part]:
    """Other parts less the files that this one replaces; none of which only inputs are left."""
    left = {}
    for part, other in others.items():
        files = {
            name: digest
            for name, digest in other.files.items()
            if mine.files.get(name, digest) == digest
        }
        if not all(map(_is_input, files)):
            left[part] = replace(other, files=files)
    return left


# A folder that changes from its old content to its new one in a single step,
# whatever happens on the way.
#
# The new content is written beside the folder, flushed to disk, and exchanged with it by one call
# of the system. Where that cannot be done (the folder is a mount point, holds the working directory
# or folders of others, its file system exchanges nothing, or the system is not Linux), everything
# is first written into a folder inside it; a rename says that it is complete, and only then are the
# files moved to their places. Who reads a folder between this and the end sees `PENDING` in it.

# Folder inside an output folder while its files are moved into their places.
PENDING = ".dqforge-swap"
_STAGED = ".dqforge-new"
_RENAME_EXCHANGE = 2
_AT_FDCWD = -100


def _fill(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a new folder in their order, each flushed to disk."""
    folder.mkdir()
    for name, content in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    flush_folder(folder)


def _exchange(first: Path, second: Path) -> None:
    """Exchange two folders in one step; raises OSError where the system cannot."""
    library = ctypes.CDLL(None, use_errno=True)
    call = getattr(library, "renameat2", None)
    if call is None:
        raise OSError("the system exchanges no folders")
    done = call(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE)
    if done != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def files_below(folder: Path) -> Iterator[str]:
    """Names, relative to a folder, of everything in it that is no folder.

    Links are not followed.
    """
    for place, folders, files in os.walk(folder):
        linked = [name for name in folders if (Path(place) / name).is_symlink()]
        for name in (*files, *linked):
            yield (Path(place) / name).relative_to(folder).as_posix()


def _holds_only_files(folder: Path, own: Collection[str]) -> bool:
    """Whether all that a folder holds beside dqforge's own files can be carried over by links."""
    for entry in folder.iterdir():
        mode = entry.lstat().st_mode
        if stat.S_ISDIR(mode):
            if not any(name.startswith(f"{entry.name}/") for name in own):
                return False
            if any(f"{entry.name}/{name}" not in own for name in files_below(entry)):
                return False
        elif not stat.S_ISREG(mode) and not stat.S_ISLNK(mode):
            return False
    return True


def _can_exchange(folder: Path, own: Collection[str]) -> bool:
    if not system.LINUX:
        return False
    here = Path.cwd()
    if folder == here or folder in here.parents or os.path.ismount(folder):
        return False  # whoever stands in the folder would be left in the old one
    about, above = folder.stat(), folder.parent.stat()
    if about.st_dev != above.st_dev or os.listxattr(folder):
        return False
    return _holds_only_files(folder, own)


def _same_file(first: Path, second: Path) -> bool:
    try:
        a, b = first.lstat(), second.lstat()
    except OSError:
        return False
    return (a.st_dev, a.st_ino) == (b.st_dev, b.st_ino)


def _retire(old: Path, folder: Path, own: Collection[str]) -> None:
    """Remove a folder that was exchanged, without losing what somebody put into it meanwhile."""
    for name in list(files_below(old)):
        left, there = old / name, folder / name
        if name not in own and not _same_file(left, there):
            newer = not os.path.lexists(there) or left.lstat().st_mtime > there.lstat().st_mtime
            if newer:
                there.parent.mkdir(parents=True, exist_ok=True)
                left.replace(there)
                continue
        with suppress(OSError):  # tried again below
            left.unlink()
    shutil.rmtree(old, ignore_errors=True)


def clear_sibling(sibling: Path, folder: Path, own: Collection[str] | None) -> None:
    """Remove what a killed run left beside a folder.

    ``own`` names dqforge's files in it; None says that it was never completed: copies and links,
    nothing that is only there.
    """
    if own is None:
        shutil.rmtree(sibling, ignore_errors=True)
    else:
        _retire(sibling, folder, own)


def siblings(folder: Path) -> list[Path]:
    """What killed runs left beside a folder."""
    return [path for path in left_beside(folder) if path.is_dir()]


def _swap(
    folder: Path, contents: Mapping[str, bytes], carried: Collection[str], own: Collection[str]
) -> None:
    """Write beside the folder, and put that in its place in one step.

    Raises OSError with everything as it was.
    """
    sibling = beside(folder)
    exists = folder.is_dir()
    try:
        _fill(sibling, contents)
        if exists:
            about = folder.stat()
            os.chown(sibling, about.st_uid, about.st_gid)
            sibling.chmod(stat.S_IMODE(about.st_mode))
        for name in carried:
            place = sibling / name
            place.parent.mkdir(parents=True, exist_ok=True)
            os.link(folder / name, place, follow_symlinks=False)
        flush_folder(sibling)
        if exists:
            _exchange(sibling, folder)
        else:
            sibling.rename(folder)
    except BaseException:
        shutil.rmtree(sibling, ignore_errors=True)
        raise
    # It is new from here on: what cannot be flushed or removed any more is left to the next run.
    with suppress(OSError):
        flush_folder(folder.parent)
    if exists:
        with suppress(OSError):
            _retire(sibling, folder, own)


def finish_pending(folder: Path, marker: str) -> None:
    """Move the files of a run that was cut off into their places; its ``marker`` goes last."""
    pending = folder / PENDING
    names = sorted(files_below(pending), key=lambda name: (name == marker, name))
    for name in names:
        _make_room(folder, name)
        (pending / name).replace(folder / name)
    with suppress(OSError):  # as in `_swap`: it is new from here on
        flush_folder(folder)
    shutil.rmtree(pending)


def _remove(folder: Path, names: Collection[str]) -> None:
    for name in names:
        (folder / name).unlink(missing_ok=True)


def _make_room(folder: Path, name: str) -> None:
    """The folder in which a file is to lie."""
    place = (folder / name).parent
    if not place.is_dir():
        place.mkdir(parents=True)


def _replace_inside(
    folder: Path, contents: Mapping[str, bytes], superseded: Collection[str], marker: str
) -> None:
    """Write into the folder itself, say so, and move every file to its place."""
    staged, pending = folder / _STAGED, folder / PENDING
    shutil.rmtree(staged, ignore_errors=True)
    try:
        _fill(staged, contents)
        for name in contents:  # what takes room is done before anything moves
            _make_room(folder, name)
        staged.rename(pending)
        flush_folder(folder)
    except BaseException:
        shutil.rmtree(staged, ignore_errors=True)
        shutil.rmtree(pending, ignore_errors=True)
        remove_empty_folders(folder, contents)
        raise
    try:
        _move_in(folder, superseded, marker)
    except OSError:  # once more: what is refused once may pass, and half moved helps nobody
        _move_in(folder, superseded, marker)
    remove_empty_folders(folder, superseded)


def _move_in(folder: Path, superseded: Collection[str], marker: str) -> None:
    _remove(folder, superseded)
    if (folder / PENDING).is_dir():
        finish_pending(folder, marker)


def remove_empty_folders(folder: Path, names: Collection[str]) -> None:
    """Remove the folders in which files of these names lay, as far as they are empty."""
    for below in sorted({Path(name).parent for name in names} - {Path()}, reverse=True):
        try:
            (folder / below).rmdir()
        except OSError:
            continue


def replace_content(
    folder: Path,
    contents: Mapping[str, bytes],
    own: Collection[str],
    superseded: Collection[str],
    marker: str,
) -> None:
    """Put files into a folder all at once; what others put there stays.

    Args:
        folder: Real path (no link); need not exist, its parent must.
        contents: Files by name relative to the folder, ``marker`` last.
        own: Names of dqforge's files that lie there now.
        superseded: Those of them that go away.
        marker: Name of the file by which a complete folder is known.

    Raises:
        OSError: The folder cannot be written; it is as it was.
    """
    if not folder.is_dir():
        _swap(folder, contents, (), ())
        return
    if _can_exchange(folder, {*own, *contents}):
        carried = [
            name for name in files_below(folder) if name not in contents and name not in superseded
        ]
        try:
            _swap(folder, contents, carried, {*contents, *superseded})
        except OSError:
            # no exchange, no links, or no right to the folder above:
            # the way inside needs none of them
            pass
        else:
            return
    _replace_inside(folder, contents, superseded, marker)


# The list of what dqforge wrote into a folder: every file with its SHA-256, by the command that
# made it.

LAYOUT = 2


_WRITTEN = "the folder that 'dqforge run', 'export' or 'simulate' wrote"


@dataclass(frozen=True, slots=True)
class Part:
    """What one command wrote: the digest of its design, and the SHA-256 of each file
    by its name in the folder.

    ``version`` wrote it, ``computed_with`` the processor and the libraries of then. ``design`` is
    the name of the design with its prefix, empty where there is none; ``options`` are those of the
    command on which its files depend, with the command itself.
    """

    digest: str
    files: dict[str, str]
    version: str = __version__
    computed_with: dict[str, str] = field(default_factory=dict)
    design: str = ""
    options: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Manifest:
    """All parts of a folder by name."""

    parts: dict[str, Part]

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of every file by name."""
        return {name: digest for part in self.parts.values() for name, digest in part.files.items()}


def sha256(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def part_of(
    digest: str,
    files: Mapping[str, bytes],
    design: str = "",
    options: Mapping[str, str] | None = None,
) -> Part:
    """The part that files make here and now; arguments as of `Part`."""
    hashes = {name: sha256(content) for name, content in sorted(files.items())}
    return Part(
        digest, hashes, computed_with=computed_with(), design=design, options=dict(options or {})
    )


def _sealed(plain: dict[str, Any]) -> str:
    """SHA-256 over the list itself, so that a change of the list is seen as well."""
    return sha256(json.dumps(plain, sort_keys=True).encode("ascii"))


def to_bytes(manifest: Manifest) -> bytes:
    """The file: the same bytes for the same content."""
    parts = {
        name: {
            "dqforge": part.version,
            "computed_with": dict(sorted(part.computed_with.items())),
            "design": part.design,
            "design_sha256": part.digest,
            "options": dict(sorted(part.options.items())),
            "files": dict(sorted(part.files.items())),
        }
        for name, part in sorted(manifest.parts.items())
    }
    plain: dict[str, Any] = {"layout": LAYOUT, "parts": parts}
    return (json.dumps(plain | {"sha256": _sealed(plain)}, indent=1) + "\n").encode("ascii")


def _is_name(name: object) -> bool:
    """Whether a name stays inside the folder."""
    if not isinstance(name, str) or not name or "\\" in name or "\0" in name:
        return False
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and str(path) == name


def _texts(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(entry, str) for entry in value.values())


def _read_part(value: object) -> Part:
    """A part of plain data; raises ValueError where it is none."""
    if (
        not isinstance(value, dict)
        or not _texts(value.get("computed_with"))
        or not _texts(value.get("files"))
        or not _texts(value.get("options"))
    ):
        raise ValueError("no manifest")
    files, version, digest = value["files"], value.get("dqforge"), value.get("design_sha256")
    design = value.get("design")
    if (
        not isinstance(version, str)
        or not isinstance(digest, str)
        or not isinstance(design, str)
        or not all(_is_name(name) for name in files)
    ):
        raise ValueError("no manifest")
    return Part(
        digest, dict(files), version, dict(value["computed_with"]), design, dict(value["options"])
    )


def from_bytes(content: bytes) -> Manifest:
    """A list as `to_bytes` wrote it.

    Raises:
        ValueError: It is none, or it was changed.
    """
    try:
        loaded = strict_json(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(loaded, dict) or loaded.get("layout") != LAYOUT:
        raise ValueError("no manifest")
    seal = loaded.pop("sha256", None)
    parts = loaded.get("parts")
    if not isinstance(parts, dict) or seal != _sealed(loaded):
        raise ValueError("no manifest, or changed")
    found = Manifest({name: _read_part(part) for name, part in parts.items()})
    if to_bytes(found) != content.replace(b"\r\n", b"\n"):
        raise ValueError("not as it was written")
    return found


def read_manifest(folder: Path) -> Manifest:
    """The list of a folder.

    Raises:
        InputError: There is none, or it is not what dqforge wrote.
    """
    path = folder / MANIFEST
    content = read_output(path, _WRITTEN, LARGEST_JSON)
    try:
        return from_bytes(content)
    except ValueError as error:
        raise InputError(
            "is not what dqforge wrote; run the design again", source=str(path)
        ) from error


def find_manifest(folder: Path) -> Manifest | None:
    """The list of a folder, None where there is none that can be trusted."""
    try:
        return from_bytes(read_regular_file(folder / MANIFEST, LARGEST_JSON))
    except (InputError, ValueError):
        return None
