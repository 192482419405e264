"""What the templates of codes, sine and transforms in fixed point print, for every header of that
kind.
"""

from __future__ import annotations

import math
from dataclasses import asdict

from dqforge.optimizer.fixed_control.transforms import TurnSteps
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.plain_data import PlainData


def fixed_basics(turn: TurnSteps, sine_error: float) -> PlainData:
    """Context of ``control/fixed_types.j2`` and ``control/fixed_basics.j2``, beside the names of a
    design; ``sine_error`` is that of sine and cosine in codes.
    """
    bits = turn.width - 1
    found = "exhaustive" if turn.width == 16 else "sampled"
    return {
        "format": f"q{bits}",
        "width": turn.width,
        "top": 2**bits - 1,
        "turn": asdict(turn),
        "table_bits": turn.width - 2 - max(len(turn.table) - 1, 1).bit_length() + 1,
        "sine_addends": turn.addends,
        "cosine_addends": turn.cosine_addends,
        "sine_error": f"; error at most {rounded_up(sine_error)} codes ({found})",
        "third": round(2**bits / 3),
        "inverse_root": round(2**bits / math.sqrt(3.0)),
        "half_root": round(2**bits * math.sqrt(0.75)),
    }
