"""Static checks of emitted C: permitted deviations from MISRA C:2012, and the tools."""

from __future__ import annotations

import os
import shutil

import pytest

DEVIATIONS = {
    "2.3": "types that headers share and a firmware does not use",
    "2.4": "types that headers share and a firmware does not use",
    "2.5": "macros that a firmware does not use",
    "8.9": "a table belongs beside its evaluator, not inside it",
    "10.1": "right shifts of signed numbers, which the header checks to be arithmetic",
    "12.1": "Horner's rule is read more easily without a parenthesis around every product",
    "17.7": "memcpy returns what it was given",
    "21.15": "test vectors are compared as bits",
}


def program(name: str) -> str:
    """A tool that CI must have; elsewhere its absence skips the test."""
    path = shutil.which(name)
    if path is None:
        if os.environ.get("CI"):
            pytest.fail(f"{name} is missing; CI needs it")
        pytest.skip(f"{name} is not installed")
    return path
