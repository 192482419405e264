"""Files that ship with the package, found by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from importlib.resources.abc import Traversable

from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.files.input_files import remember
from dqforge.machines.records import dataclass

# Names of the schemas, in the package and beside the files that `dqforge new` writes.
DESIGN_SCHEMA, STUDY_SCHEMA = "design.schema.json", "study.schema.json"
_SUFFIX = ".yaml"

# Names are matched before they meet the file system, so none can leave the folder.
_NAME = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*")

# Words by which an entry is found that its name and its sentence do not say.
_TAGS = re.compile(rb"^# tags:(.*)$", re.MULTILINE)

# Names that a message has room for.
_MOST_NAMES = 12

# A line with a key alone begins the first section, and ends the head of a file.
_SECTION = re.compile(rb"^[a-z_]+:[ \t]*(?:#.*)?$", re.MULTILINE)


def _library() -> Traversable:
    return resources.files("dqforge.machines") / "library"


def schema_bytes(name: str) -> bytes:
    """Bytes of a schema that ships with the package: `DESIGN_SCHEMA` or `STUDY_SCHEMA`."""
    return (_library() / "schemas" / name).read_bytes()


def with_modeline(text: bytes, schema: str) -> bytes:
    """A YAML text whose first line tells editors the schema.

    Args:
        text: UTF-8 without byte order mark.
        schema: The file of the schema as seen from that of the text, so that both may be moved
            together and no network is needed.
    """
    return f"# yaml-language-server: $schema={schema}\n".encode() + text


@dataclass(frozen=True, slots=True)
class LibraryEntry:
    """An entry of the library: ``key`` is what commands call it, ``name`` and ``about`` are those
    of its file, ``tags`` further words by which it is found: a comment ``# tags:`` in its head.
    """

    key: str
    name: str
    about: str
    tags: str = ""


@dataclass(frozen=True, slots=True)
class LibraryFiles:
    """YAML files of one kind below the folder ``library``.

    Args:
        kind: What one of them holds, for messages.
        below: Folder below ``library``; empty for itself.
        unlisted: Names that are no entries of the library.
    """

    kind: str
    below: str = ""
    unlisted: tuple[str, ...] = ()

    def _folder(self) -> Traversable:
        return _library() / self.below if self.below else _library()

    def names(self) -> list[str]:
        """Names of the entries, in alphabetical order."""
        files = (entry.name for entry in self._folder().iterdir() if entry.name.endswith(_SUFFIX))
        found = (name.removesuffix(_SUFFIX) for name in files)
        return sorted(name for name in found if name not in self.unlisted)

    def read(self, name: str) -> bytes:
        """Bytes of the entry of a name.

        Raises:
            InputError: There is none of this name; the message has those that are like it.
        """
        known = self.names()
        if not _NAME.fullmatch(name) or name not in known:
            raise self.unknown(name, known)
        return self.read_unlisted(name)

    def unknown(self, name: str, known: Sequence[str]) -> InputError:
        """Error on a name that is none of those known; it has those that are like it."""
        matches = close_matches(name, known) or [part for part in known if name and name in part]
        if matches:
            hint = f"did you mean {' or '.join(matches[:2])}?"
        elif len(known) <= _MOST_NAMES:
            hint = f"there are {', '.join(known)}"
        else:
            hint = "'dqforge machines --search WORDS' finds one"
        return InputError(f"no {self.kind} {shown(name)} in the library; {hint}")

    def read_unlisted(self, name: str) -> bytes:
        """Bytes of a file that is there, listed or not."""
        content = (self._folder() / self.source(name)).read_bytes()
        remember(self.source(name), content)
        return content

    def entries(self) -> list[LibraryEntry]:
        """All entries by the heads of their files: nothing is built of them."""
        return [self._entry(name) for name in self.names()]

    def _entry(self, name: str) -> LibraryEntry:
        from dqforge.machines.files.positioned_yaml import parse_yaml  # completion needs no YAML

        head = _SECTION.split(self.read_unlisted(name), maxsplit=1)[0]
        data = parse_yaml(head, self.source(name)).data
        title, about = (" ".join(str(data[part]).split()) for part in ("name", "about"))
        tags = b" ".join(_TAGS.findall(head)).decode("utf-8")
        return LibraryEntry(name, title, about, " ".join(tags.split()))

    def source(self, name: str) -> str:
        """What messages call the file of an entry."""
        return name + _SUFFIX


TEMPLATE = "template"  # Name of the design file that a new one starts from.

# The drives of research, the motors that people have, and the studies that ship with the package.
DESIGNS, STUDIES = LibraryFiles("design", unlisted=(TEMPLATE,)), LibraryFiles("study", "studies")
MOTORS = LibraryFiles("design", "motors")


def design_names() -> list[str]:
    """What a command may name in place of a design file: drives, then motors."""
    return [*DESIGNS.names(), *MOTORS.names()]


def read_design(name: str) -> bytes:
    """Bytes of a drive or a motor; raises `InputError` as `LibraryFiles.read`."""
    motors = MOTORS.names()
    if name in motors:
        return MOTORS.read(name)
    drives = DESIGNS.names()
    if name not in drives:
        raise DESIGNS.unknown(name, [*drives, *motors])
    return DESIGNS.read(name)
