"""What the theme of the site leaves is mended, once, and nothing else changes."""

from __future__ import annotations

from accessible_pages import mended, mended_style

PAGE = """<aside class="sidebar-drawer">a</aside>
<article role="main" id="furo-main-content">
<h1>Title</h1>
<div class="highlight"><pre><span></span>code</pre></div>
<div class="table-wrapper docutils container">
<table><thead><tr><th class="head"><p>Key</p></th><th class="head"><p></p></th></tr></thead></table>
</div>
</article>
<aside class="toc-drawer no-toc">b</aside>
<div id="search-results"></div>
"""

MENDED = """<aside class="sidebar-drawer" aria-label="Site">a</aside>
<div role="main" id="furo-main-content">
<h1>Title</h1>
<div class="highlight"><pre tabindex="0"><span></span>code</pre></div>
<div class="table-wrapper docutils container" tabindex="0">
<table><thead><tr><th class="head"><p>Key</p></th><td></td></tr></thead></table>
</div>
</div>
<aside class="toc-drawer no-toc" aria-label="On this page">b</aside>
<h1>Search</h1>
<div id="search-results"></div>
"""


def test_a_page_is_mended_once() -> None:
    assert mended(PAGE) == MENDED
    assert mended(MENDED) == MENDED


def test_rules_for_the_article_are_those_of_the_main_part() -> None:
    style = "article h1,article{a:b}.article-container{c:d}article[role=main] *{e:f}"
    assert mended_style(style) == (
        "[role=main] h1,[role=main]{a:b}.article-container{c:d}[role=main][role=main] *{e:f}"
    )
