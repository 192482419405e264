"""What lies in the folder of a run: the names of what stands beside the emitted files, and the
files beside a page as its table of links.
"""

from __future__ import annotations

import base64
import hashlib
import posixpath
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING
from urllib.parse import quote

from dqforge.machines.design.design import DesignFiles
from dqforge.machines.records import dataclass
from dqforge.reports.pages.html_text import HtmlTable, Row, count
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from markupsafe import Markup


# Name of the list of the files in its folder; it is written last.
MANIFEST = "dqforge-manifest.json"

# Folder in the output folder that holds the design file and, below ``files``, those that it names.
INPUT = "dqforge-input"
INPUT_DESIGN = f"{INPUT}/design.yaml"
RESULT, REPORT = "result.json", "report.html"


def input_files(given: DesignFiles | None, root: str = INPUT) -> dict[str, bytes]:
    """The files from which a design can be read again, by their names in the output folder."""
    if given is None:
        return {}
    named = {f"{root}/files/{posixpath.normpath(name)}": content for name, content in given.named}
    return {f"{root}/design.yaml": given.text} | named


def listed_files(
    files: Mapping[str, bytes], told: Mapping[str, str], given: DesignFiles | None
) -> list[ListedFile]:
    """The files of a run as its report lists them.

    Args:
        files: What the run wrote before the report, by name.
        told: What each is, by name.
        given: What the design was read from.
    """
    inputs = input_files(given)
    words = {INPUT_DESIGN: "the design, as it was read"}
    listed = [ListedFile.of(name, told.get(name, ""), files[name]) for name in files]
    listed += [
        ListedFile.of(name, words.get(name, "a file that the design names"), content)
        for name, content in inputs.items()
    ]
    return [*listed, ListedFile(MANIFEST, "every file of this folder with its SHA-256")]


# The files that lie beside a page, as its table of links: what each is, its size, its SHA-256.

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


# The few scripts that a page may run: written in templates of the package, admitted by their
# SHA-256 and nothing else.

FIGURES = "pages/figures.js.j2"  # Tells the values of figures under the pointer.
# Opens the folded part to which a link leads, marks in the contents where one is, opens all for
# print.
FOLDING = "pages/folding.js"


@dataclass(frozen=True, slots=True)
class PageScripts:
    """Scripts of one page.

    Args:
        policy: Content security policy of the page: nothing but its own styles, pictures within it,
            and these scripts.
        texts: What stands between ``<script>`` and ``</script>``, byte for byte what was hashed.
    """

    policy: str
    texts: tuple[Markup, ...]


def page_scripts(*templates: str) -> PageScripts:
    """The scripts of a page, and the policy that admits them.

    Args:
        templates: Files ``<room>/<file>.js``, or templates of them; they take no values.
    """
    from markupsafe import Markup

    # White space at the ends counts in the hash; checkers of HTML strip it first.
    texts = tuple(Markup(render(template, {}).strip()) for template in templates)
    sources = " ".join(f"'{_hash(text)}'" for text in texts)
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    return PageScripts(f"{policy}; script-src {sources}" if sources else policy, texts)


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
