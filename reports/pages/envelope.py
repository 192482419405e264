"""The frame of every JSON output: format, command and name."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from dqforge import __version__
from dqforge.reports.pages.certificate_text import JSON_DIGITS
from dqforge.reports.plain_data import PlainData

FORMAT = 1  # Version of the layout; it rises when a key is renamed or removed.


def _clean(value: Any) -> Any:
    """Plain data with nine significant digits: enough to read back a float32,
    few enough to be the same everywhere.

    Infinite and undefined numbers become null, which JSON can hold.
    """
    if isinstance(value, dict):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return _clean(value.tolist())
    if isinstance(value, np.generic):
        return _clean(value.item())
    if isinstance(value, float):
        return float(f"{value:.{JSON_DIGITS}g}") if math.isfinite(value) else None
    return value


def to_text(command: str, name: str, result: PlainData) -> str:
    """The JSON document of a command: an envelope with the versions around the result;
    ends with a line feed.
    """
    envelope = {
        "dqforge": __version__,
        "format": FORMAT,
        "command": command,
        "design": name,
        **result,
    }
    return json.dumps(_clean(envelope), indent=1, ensure_ascii=True, allow_nan=False) + "\n"
