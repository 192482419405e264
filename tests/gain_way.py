"""Files whose functions hold the i_q gain of a command: ``python gain_way.py run DESIGN -o OUT``.

A function is counted where at its end a local or what it returns is the gain, its text, or a
record, an array or a container that has it.
"""

from __future__ import annotations

import json
import sys
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from dqforge.cli import main
from dqforge.machines.design import catalogue
from dqforge.optimizer.control_design.gain_set import solve_gains

ROOT = Path(__file__).resolve().parent.parent

# Members of a container that are looked at: longer ones are data.
_MOST = 64


def _parts(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return list(value.values())[:_MOST]
    if isinstance(value, list | tuple):
        return list(value[:_MOST])
    if is_dataclass(value):
        return [getattr(value, field.name, None) for field in fields(value)]
    return []


def holds(value: Any, gain: float, depth: int = 1) -> bool:
    """Whether a value is the gain (to seven digits), or has it among its members."""
    if isinstance(value, float):
        return abs(value - gain) < 1e-7 * gain
    if isinstance(value, str):
        return len(value) < 6 * _MOST and f"{gain:.5g}" in value
    if isinstance(value, np.ndarray):
        near = value.dtype == float and value.size < _MOST
        return bool(near and np.any(np.abs(value - gain) < 1e-7 * gain))
    return depth > 0 and any(holds(part, gain, depth - 1) for part in _parts(value))


@cache
def _is_ours(name: str) -> bool:
    if name.startswith("<"):  # text that is compiled, as a template is
        return False
    path = Path(name).resolve()
    return path.is_relative_to(ROOT) and not {"tests", ".venv"} & set(path.parts)


def files_on_the_way(arguments: list[str], gain: float) -> list[str]:
    """Modules of the project, below its root, that hold the gain while a command runs."""
    found: set[str] = set()

    def at_return(frame: FrameType, event: str, result: object) -> None:
        name = frame.f_code.co_filename
        if event != "return" or name in found or not _is_ours(name):
            return
        sys.setprofile(None)
        if any(holds(value, gain) for value in [result, *frame.f_locals.values()]):
            found.add(name)
        sys.setprofile(at_return)

    sys.setprofile(at_return)
    try:
        main(arguments)
    except SystemExit:
        pass
    finally:
        sys.setprofile(None)
    return sorted(str(Path(name).resolve().relative_to(ROOT)) for name in found)


if __name__ == "__main__":
    design = catalogue.load(sys.argv[2])
    json.dump(files_on_the_way(sys.argv[1:], solve_gains(design).i_q.kp), sys.stderr)
