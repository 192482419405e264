"""A machine without compilers, for one test."""

from __future__ import annotations

import shutil

import pytest

from dqforge.reports.operating_system import host_compiler


def hide_compilers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a program on the PATH nor the compiler of the package index is found."""
    monkeypatch.setattr(shutil, "which", lambda *_args, **_options: None)
    monkeypatch.setattr(host_compiler, "packaged_zig", lambda: None)
    for name in host_compiler.VARIABLES.values():
        monkeypatch.delenv(name, raising=False)
