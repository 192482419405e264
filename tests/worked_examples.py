"""The worked examples of docs/project/contributing.md: their files, as a contributor would write
them, in the page or in tests/toys.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

PAGE = Path(__file__).parents[1] / "docs" / "project" / "contributing.md"
TOYS = Path(__file__).parent / "toys"


def text_of(path: str, place: int = 0) -> str:
    """The text that the page gives for a file of the package, in the order of the page."""
    start = r"(?:# |\{# )" + re.escape(path) + r"(?: #\})?\n"
    texts: list[str] = re.findall(rf"^```\w+\n{start}(.*?)^```$", PAGE.read_text(), re.S | re.M)
    return texts[place]


@contextmanager
def module_of(path: str, folder: Path) -> Iterator[ModuleType]:
    """The module that stands for a file of the package, imported from another folder."""
    file = folder / Path(path).name
    toy = TOYS / file.name
    file.write_text(toy.read_text() if toy.exists() else text_of(path))
    name = f"worked_example_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
        yield module
    finally:
        del sys.modules[name]
