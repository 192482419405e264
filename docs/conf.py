"""How the site of the documentation is built: `make docs`, into out/docs."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "extensions"))

from dqforge import __version__ as version

project = "dqforge"
release = version
# No year: the same sources give the same bytes whenever they are built.
project_copyright = "the authors of dqforge; Apache-2.0"

extensions = [
    "accessible_pages",
    "api_reference",
    "command_reference",
    "file_reference",
    "message_reference",
    "mathml",
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["drawing", "extensions"]
language = "en"
# Quotes and dashes are often those of a command.
smartquotes = False
nitpicky = True
# What a terminal shows is no programme: where a quote in it stays open, the block has no colours.
suppress_warnings = ["misc.highlighting_failure"]
# Blocks without a language are what a terminal or a sheet of paper shows.
highlight_language = "text"

myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
# Headings are linked to as GitHub names them, so that links hold in both places.
myst_heading_anchors = 4
myst_links_external_new_tab = False

html_theme = "furo"
html_title = "dqforge"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_last_updated_fmt = None
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#1f6fb2",
        "color-brand-content": "#1f6fb2",
        "color-brand-visited": "#1f6fb2",
        "color-foreground-primary": "#1b2430",
        "color-foreground-secondary": "#4b5664",
        "color-foreground-muted": "#566270",
        "color-background-primary": "#ffffff",
        "color-background-secondary": "#f4f6f8",
        "color-background-hover": "#eef1f5",
        "color-background-border": "#dce1e7",
        "color-table-header-background": "#eef1f5",
        "color-table-border": "#dce1e7",
        "color-api-name": "#1b2430",
        "color-api-pre-name": "#566270",
    },
    "dark_css_variables": {
        "color-brand-primary": "#7cb8ee",
        "color-brand-content": "#7cb8ee",
        "color-brand-visited": "#7cb8ee",
        "color-foreground-primary": "#e3e8ee",
        "color-foreground-secondary": "#b6c0cb",
        "color-foreground-muted": "#9fabb8",
        "color-background-primary": "#12161b",
        "color-background-secondary": "#1a2027",
        "color-background-hover": "#222a33",
        "color-background-border": "#303945",
        "color-table-header-background": "#222a33",
        "color-table-border": "#303945",
        "color-api-name": "#e3e8ee",
        "color-api-pre-name": "#9fabb8",
    },
}

autodoc_default_options = {"members": True, "inherited-members": "Exception, ValueError"}
autodoc_typehints = "none"
# Types of the rooms and of other libraries have no pages here.
nitpick_ignore_regex = [("py:.*", r"(?!dqforge\.[A-Za-z_]+$).*")]
# What docstrings put in single backticks is code.
default_role = "code"
autodoc_member_order = "bysource"

copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
copybutton_line_continuation_character = "\\"
