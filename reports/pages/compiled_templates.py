"""Byte code of templates, kept beside them as Python keeps that of modules."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.util import cache_from_source
from pathlib import Path

from jinja2 import __version__ as version_of_jinja
from jinja2.bccache import Bucket, BytecodeCache

from dqforge import __version__


class CompiledTemplates(BytecodeCache):
    """Where nothing can be read or written, a template is compiled in each process.

    Args:
        place: File of a template by its name; None for one whose byte code is not kept.
    """

    def __init__(self, place: Callable[[str], Path | None]) -> None:
        self._place = place

    def get_cache_key(self, name: str, filename: str | None = None) -> str:  # noqa: ARG002
        """The file of the byte code; empty where none is kept."""
        path = self._place(name)
        if path is None or sys.implementation.cache_tag is None:
            return ""
        return cache_from_source(str(path), optimization="jinja")

    def get_source_checksum(self, source: str) -> str:
        """What the byte code depends on: text and compilers."""
        return super().get_source_checksum(f"{__version__}\n{version_of_jinja}\n{source}")

    def load_bytecode(self, bucket: Bucket) -> None:
        """Read what is there; what is broken or of another text counts as nothing."""
        try:
            content = Path(bucket.key).read_bytes() if bucket.key else b""
            bucket.bytecode_from_string(content)
        except Exception:  # noqa: BLE001 (whatever a damaged file raises)
            bucket.reset()

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Write a file whole or not at all, and not where Python is to write none."""
        if not bucket.key or sys.dont_write_bytecode:
            return
        path = Path(bucket.key)
        written = path.with_suffix(f".{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            written.write_bytes(bucket.bytecode_to_string())
            written.replace(path)
        except OSError:
            with suppress(OSError):
                written.unlink()
