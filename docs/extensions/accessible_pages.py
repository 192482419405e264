"""What the theme leaves to be mended for readers with a keyboard or a screen reader, done when all
pages are written: names of landmarks, boxes that scroll, empty headings, one main part.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_MENDED = (
    # An article is a part among others and wants headings below the first; this is the page.
    (r'<article role="main" id="furo-main-content">', '<div role="main" id="furo-main-content">'),
    (r"</article>", "</div>"),
    (r'<aside class="sidebar-drawer">', '<aside class="sidebar-drawer" aria-label="Site">'),
    (r'<aside class="(toc-drawer[^"]*)">', r'<aside class="\1" aria-label="On this page">'),
    # What scrolls sideways is reached by the tab key.
    (r"<pre(?=[ >])(?![^>]*tabindex)", '<pre tabindex="0"'),
    (r'<div class="((?:table-wrapper|formula)[^"]*)">', r'<div class="\1" tabindex="0">'),
    (r"<th[^>]*>\s*(?:<p>\s*</p>)?\s*</th>", "<td></td>"),
    (r'(?<!</h1>\n)(<div id="search-results">)', r"<h1>Search</h1>\n\1"),
)


def mended(page: str) -> str:
    """A page of the site.

    Args:
        page: HTML as the theme made it.
    """
    for pattern, text in _MENDED:
        page = re.sub(pattern, text, page)
    return page


def mended_style(style: str) -> str:
    """A style sheet whose rules for the article are those of the main part.

    Args:
        style: Style sheet.
    """
    return re.sub(r"(?<![\w.#-])article(?![\w-])", "[role=main]", style)


def _mend_site(app: Sphinx, exception: Exception | None) -> None:
    if exception is not None or app.builder.format != "html":
        return
    out = Path(app.outdir)
    for path in out.rglob("*.html"):
        path.write_text(mended(path.read_text(encoding="utf-8")), encoding="utf-8")
    for path in [*(out / "_static").rglob("furo*.css"), out / "_static" / "site.css"]:
        path.write_text(mended_style(path.read_text(encoding="utf-8")), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Mend the pages when the site is built."""
    app.connect("build-finished", _mend_site)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
