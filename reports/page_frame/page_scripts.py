"""The few scripts that a page may run: written in templates of the package, admitted by their
SHA-256 and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from markupsafe import Markup

FIGURES = "pages/figures.js.j2"  # Tells the values of figures under the pointer.
# Opens the folded part to which a link leads, marks in the contents where one is, opens all for
# print.
FOLDING = "pages/folding.js.j2"


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
        templates: Templates ``<room>/<file>.js.j2``; they take no values.
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
