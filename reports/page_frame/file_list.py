"""The files that lie beside a page, as its table of links: what each is, its size, its SHA-256."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import TYPE_CHECKING
from urllib.parse import quote

from dqforge.machines.records import dataclass
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import count

if TYPE_CHECKING:
    from markupsafe import Markup

SHORT = 12  # Digits of a SHA-256 that are shown.


@dataclass(frozen=True, slots=True)
class ListedFile:
    """A file beside a page.

    Args:
        name: Its path from the page, with ``/`` between folders; a folder ends with one.
        what: What it is, in a few words.
        size: Bytes, None where they are not known yet when the page is written.
        digest: SHA-256 in hexadecimal, empty where it is not known.
    """

    name: str
    what: str
    size: int | None = None
    digest: str = ""

    @classmethod
    def of(cls, name: str, what: str, content: bytes) -> ListedFile:
        """A file whose bytes are known."""
        return cls(name, what, len(content), hashlib.sha256(content).hexdigest())


def files_table(files: Iterable[ListedFile], caption: str, *notes: str) -> HtmlTable:
    """Files with links to them.

    Args:
        files: In the order of the table.
        caption: Of the table.
        notes: Sentences below it.
    """
    rows = tuple(Row(_cells(file)) for file in files)
    return HtmlTable(caption, ("File", "What it is", "Bytes", "SHA-256"), rows, 2, notes)


def _cells(file: ListedFile) -> tuple[str | Markup, ...]:
    from markupsafe import Markup

    # As a path of its own: a name can hold a colon, and is no scheme.
    link = Markup('<a href="{}"><code>{}</code></a>').format(quote(file.name), file.name)
    digest = Markup("<code>{}</code>").format(file.digest[:SHORT]) if file.digest else ""
    return (link, file.what, "" if file.size is None else count(file.size), digest)
