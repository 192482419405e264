"""Files that a study, its design and its rows name: found in the folder of the study, read once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from dqforge.machines.design.reading import MAX_FILE_BYTES
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study_entries import complaint
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.positioned_yaml import MAX_BYTES, YamlDocument
from dqforge.machines.places import KeyPath
from dqforge.machines.wording import close_matches

NOMINAL = "nominal"
_HEADER_ENDINGS = (".h", ".c", ".json", ".yaml")
_MOST_HEADER_FILES = 100


class StudyFolder(Mapping[str, bytes]):
    """Files in the folder of a study or below it, by the names that designs give them.

    What was asked for stays in memory. A name is looked for beside the design, then beside the
    study. ``missing`` are names that were asked for in vain.
    """

    def __init__(self, folder: Path | None, document: YamlDocument) -> None:
        self._folder, self._document = folder, document
        self._beside_design = folder
        self._found: dict[str, bytes] = {}
        self.missing: list[str] = []

    def __getitem__(self, name: str) -> bytes:
        if name not in self._found:
            contents = {
                content
                for folder in dict.fromkeys([self._beside_design, self._folder])
                if (content := self._content(folder, name)) is not None
            }
            if len(contents) != 1:
                self.missing.append(name)
                if contents:
                    raise InputError(
                        f"there is another file '{name}' beside the design than beside the study; "
                        "rename one",
                        source=self._document.source,
                    )
                raise KeyError(name)
            self._found[name] = contents.pop()
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def named(self) -> tuple[tuple[str, bytes], ...]:
        """All that was found, by name."""
        return tuple(sorted(self._found.items()))

    def _content(self, folder: Path | None, name: str) -> bytes | None:
        """Content of a file, None where there is none in the folder of the study."""
        place = self._inside(folder, name)
        if place is None:
            return None
        try:
            return read_regular_file(place, MAX_FILE_BYTES, name)
        except (InputError, OSError):
            return None

    def _inside(self, folder: Path | None, name: str) -> Path | None:
        """Where a file lies; None where there is none in the folder of the study."""
        if folder is None or self._folder is None or not name or Path(name).is_absolute():
            return None
        try:
            place = (folder.resolve() / name).resolve()
            inside = place.is_relative_to(self._folder.resolve()) and place.exists()
        except (OSError, RuntimeError, ValueError):
            return None
        return place if inside else None

    def design(self, name: str) -> tuple[bytes, str]:
        """Bytes and name of the design beside the study.

        Raises `InputError` where there is none.
        """
        place = self._place(name, ("design",), "design")
        self._beside_design = place.parent
        try:
            return read_regular_file(place, MAX_BYTES, name), name
        except InputError as error:
            raise complaint(self._document, ("design",), f"{name}: {error.message}") from None

    def _place(self, name: str, path: KeyPath, what: str) -> Path:
        """Where a part of the study lies; raises `InputError` where it is not there."""
        if self._folder is None:
            raise complaint(
                self._document, path, f"a study of the library cannot name a {what}; copy the study"
            )
        place = self._inside(self._folder, name)
        if place is not None:
            return place
        outside = Path(name).is_absolute() or ".." in Path(name).parts
        if outside:
            raise complaint(
                self._document,
                path,
                f"'{name}' lies outside the folder of the study; copy it there",
            )
        hint = self._alike(name)
        raise complaint(self._document, path, f"there is no {what} '{name}' beside the study{hint}")

    def _alike(self, name: str) -> str:
        """What a name that is not there may have been meant to be."""
        try:
            names = [entry.name for entry in self._folder.iterdir()] if self._folder else []
        except OSError:
            return ""
        matches = close_matches(name, sorted(names))
        return f"; did you mean {' or '.join(matches)}?" if matches else "; check the name"

    def header(self, name: str | None) -> tuple[tuple[str, bytes], ...]:
        """Files of the folder of a fixed header by their names, none for `NOMINAL`.

        Raises `InputError` where there is no such folder, or no header in it.
        """
        path: KeyPath = ("header",)
        if name is None or name == NOMINAL:
            return ()
        place = self._place(name, path, "folder")
        if not place.is_dir():
            raise complaint(
                self._document, path, f"'{name}' is a file; name the folder that it lies in"
            )
        names = sorted(entry.name for entry in place.iterdir() if entry.is_file())
        kept = [entry for entry in names if entry.endswith(_HEADER_ENDINGS)]
        if not any(entry.endswith(".h") for entry in kept):
            raise complaint(
                self._document,
                path,
                f"there is no header in '{name}'; name a folder that 'dqforge run' wrote, or "
                f"write {NOMINAL}",
            )
        if len(kept) > _MOST_HEADER_FILES:
            message = f"'{name}' holds {len(kept)} files; name a folder that 'dqforge run' wrote"
            raise complaint(self._document, path, message)
        try:
            return tuple(
                (entry, read_regular_file(place / entry, MAX_FILE_BYTES, entry)) for entry in kept
            )
        except InputError as error:
            raise complaint(self._document, path, f"{error.source}: {error.message}") from None

    def listed(self, pattern: str) -> list[str]:
        """Names of the files that a pattern such as ``devices/*.json`` stands for, in their order.

        Raises `InputError` without a position where there is none.
        """
        if not any(sign in pattern for sign in "*?["):
            return [pattern]
        if self._folder is None:
            raise InputError("a study of the library cannot name files; copy the study")
        if Path(pattern).is_absolute() or ".." in Path(pattern).parts:
            raise InputError(f"'{pattern}' lies outside the folder of the study; copy it there")
        try:
            places = [place for place in self._folder.glob(pattern) if place.is_file()]
        except (OSError, ValueError, NotImplementedError):
            places = []
        if not places:
            raise InputError(f"no file beside the study is called '{pattern}'; check the pattern")
        return sorted(place.relative_to(self._folder).as_posix() for place in places)
