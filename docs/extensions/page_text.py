"""Filter of pyspelling: the text of a page at once, where its own starts aspell per paragraph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bs4 import BeautifulSoup
from pyspelling import filters


class PageText(filters.Filter):  # type: ignore[misc]
    """All text of an HTML file but that of the elements that CSS selectors leave out."""

    def get_default_config(self) -> dict[str, Any]:
        """No element is left out."""
        return {"ignores": []}

    def setup(self) -> None:
        """Read the option."""
        self.ignores = ", ".join(self.config["ignores"])

    def filter(self, source_file: str, encoding: str) -> list[Any]:
        """One text for the file, a line for each piece of it."""
        page = BeautifulSoup(Path(source_file).read_text(encoding), "lxml")
        for left_out in page.select(self.ignores) if self.ignores else []:
            left_out.decompose()
        text = page.get_text("\n", strip=True)
        return [filters.SourceText(text, source_file, encoding, "page")]


def get_plugin() -> type[PageText]:
    """Return the filter, as pyspelling finds it."""
    return PageText
