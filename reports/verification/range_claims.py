"""What is claimed of the integers of the control in fixed point, for the program that confirms it.

Nothing is computed here: states lie between what they are clamped to, everything else is any code.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from dqforge.optimizer.fixed_control.design import FixedControlFit
from dqforge.optimizer.fixed_control.transforms import FixedControl
from dqforge.optimizer.solution import Solution

RANGES = "_ranges.json"

# In how many pieces the first argument of a function is cut, by the bits of a code.
_CUTS = {
    16: {"rotation": 512, "reciprocal": 64, "inverse_root": 64},
    32: {"rotation": 8, "reciprocal": 64, "inverse_root": 64},
}
_CONTROL = ("current_control", "speed_loop", "torque_control", "speed_control")


def range_files(solution: Solution, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The certificate of ranges by its name; none without control functions in integers.

    Args:
        solution: What was solved.
        files: The headers by name, as they are written.
    """
    prefix = solution.design.export.prefix
    fits = [fit for fit in solution.fixed if isinstance(fit, FixedControlFit)]
    if not fits:
        return {}
    plain: dict[str, Any] = {
        "format": 1,
        "not_covered": ["position observers"] if solution.fixed_observers else [],
        "headers": [],
        "cuts": {},
        "wraps": ["turn"],  # an angle
        "states": {},
        "calls": [],
    }
    for control in (fit.control for fit in fits):
        name = f"{prefix}_control_{control.format}.h"
        text = files[name].decode("utf-8")
        plain["headers"].append(name)
        cuts = _CUTS[control.width].items()
        plain["cuts"] |= {f"{prefix}_{part}_{control.format}": many for part, many in cuts}
        plain["states"] |= _states(control)
        for part, arguments, after in _calls(control, prefix.upper()):
            function = f"{prefix}_{part}_{control.format}"
            if re.search(rf"\b{function}\(", text):
                told = {"function": function, "arguments": arguments}
                plain["calls"].append(told | ({"after": after} if after else {}))
    text = json.dumps(plain, indent=1)
    text = re.sub(r"\[\s+(-?\d+),\s+(-?\d+)\s+\]", r"[\1, \2]", text)
    return {f"{prefix}{RANGES}": f"{text}\n".encode("ascii")}


def _around(most: int) -> list[int]:
    return [-most, most]


def _states(control: FixedControl) -> dict[str, Any]:
    """What each state always lies in; members that are not named are any code."""
    gains = control.gains
    found: dict[str, Any] = {
        f"control_{control.format}": {
            "d": {"integral": _around(gains.d.most)},
            "q": {"integral": _around(gains.q.most)},
            "speed": {"integral": _around(gains.speed.most)},
            "filtered": _around(control.top << (control.width - 2)),
            "count": [0, max(control.ratio - 1, 0)],
        }
    }
    for name, forms in control.loops.items():
        for form, pi in forms.items():
            most = control.top << pi.fraction
            state: dict[str, Any] = {"integral": _around(most)}
            if form == "velocity":
                error = (1 << control.width) - 1
                ends = [(pi.kp.mantissa * x + pi.kp.half) >> pi.kp.shift for x in (-error, error)]
                state = {"output": _around(most), "proportional": ends}
            found[f"{name}_{form}_{control.format}"] = state
    if control.observer is not None:
        found[f"observer_{control.format}"] = {"zeta": _around(control.zeta_max)}
    return found


def _calls(control: FixedControl, upper: str) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Function, arguments, and what is told of a state afterwards where it is not the same."""
    f, top = control.format, control.top
    end = f.upper()
    whole = f"{upper}_CONTROL_GAINS_{end}"
    turn = {"cosine": _around(top), "sine": _around(top)}
    error, limit = _around((1 << control.width) - 1), [0, top]
    own = f"control_{f}"
    found: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
        ("rotation", {"theta": "any"}, {}),
        ("clarke", {"x": "any"}, {}),
        ("clarke_inverse", {"x": "any"}, {}),
        ("park", {"x": "any", "turn": turn}, {}),
        ("park_inverse", {"x": "any", "turn": turn}, {}),
        ("duties", {"v": "any", "v_dc": [1, top], "i": "any"}, {}),
        ("decoupling", {"gains": f"{whole}.decoupling", "omega_m": "any", "i": "any"}, {}),
    ]
    for name in control.loops:
        constant = f"{upper}_{name.replace('_', '').upper()}"
        given = {"error": error, "limit": limit}
        for form, part, middle in (
            ("parallel", "pi_step", ""),
            ("velocity", "pi_velocity_step", "VELOCITY_"),
        ):
            gains = f"{constant}_{middle}GAINS_{end}"
            found.append((part, {"gains": gains, "state": f"{name}_{form}_{f}", **given}, {}))
    if control.observer is not None:
        state, gains = f"observer_{f}", f"{upper}_REDUCED_ORDER_GAINS_{end}"
        found += [
            ("reduced_order_start", {"state": "any", "omega_m": "any"}, {"state": state}),
            ("reduced_order_step", {"gains": gains, "state": state, "v": "any", "i": "any"}, {}),
        ]
    rest = {"measured": "any", "omega_m": "any", "reference": "any", "torque": "any"}
    needs = (
        ("measured", "reference"),
        ("omega_m", "reference"),
        ("measured", "torque"),
        ("measured", "speed_reference"),
    )
    found.append(("control_start", {"state": "any"}, {"state": own}))
    for part, names in zip(_CONTROL, needs, strict=True):
        arguments = {name: rest.get(name, "any") for name in names}
        found.append((part, {"gains": whole, "state": own, **arguments}, {}))
    return found
