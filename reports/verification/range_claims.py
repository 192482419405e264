"""What is claimed of the integers of control and position observers in fixed point, for the program
that confirms it.

Nothing is computed here: states lie between what they are clamped to, everything else is any code.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dqforge.machines.records import dataclass
from dqforge.optimizer.fixed_control.codes import full_scale
from dqforge.optimizer.fixed_control.design import FixedControlFit
from dqforge.optimizer.fixed_control.transforms import FixedControl, speed_loop_gains
from dqforge.optimizer.solution import Solution

if TYPE_CHECKING:
    from dqforge.optimizer.fixed_observers.fixed_observer_fit import FixedPositionObserver
    from dqforge.optimizer.fixed_phase_control.integers import FixedPhaseControl
    from dqforge.optimizer.fixed_phase_control.solve import IntegerFit

RANGES = "_ranges.json"

# In how many pieces the first argument of a function is cut, by the bits of a code.
_CUTS = {
    16: {"rotation": 512, "reciprocal": 64, "inverse_root": 64},
    32: {"rotation": 8, "reciprocal": 64, "inverse_root": 64},
}
_CORE = 32  # Bits of the codes within an observer.
_HALVED = (1 << 27) - 1  # What the Kalman filter halves variances to.

# Function, arguments, and what is told of a state afterwards where it is not the same.
Call = tuple[str, dict[str, Any], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class _Part:
    """What is claimed of one header; functions are named without prefix and format.

    ``wraps`` are variables that are angles, or functions that make one: conversions take the
    remainder.
    """

    header: str
    width: int
    states: dict[str, Any]
    calls: list[Call]
    wraps: tuple[str, ...]


def range_files(solution: Solution, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The certificate of ranges by its name; none without control functions in integers.

    Args:
        solution: What was solved.
        files: The headers by name, as they are written.
    """
    prefix = solution.design.export.prefix
    upper = prefix.upper()
    parts = [_control_part(fit, upper) for fit in solution.fixed]
    parts += [_observer_part(fit.observer, upper) for fit in solution.fixed_observers]
    if not parts:
        return {}
    plain: dict[str, Any] = {"format": 1, "not_covered": [], "headers": []}
    plain |= {"cuts": {}, "wraps": [], "states": {}, "calls": []}
    for part in parts:
        form = _format(part.width)
        name = f"{prefix}_{part.header}_{form}.h"
        there = set(re.findall(r"\w+", files[name].decode("utf-8")))
        plain["headers"].append(name)
        plain["states"] |= part.states
        wraps = (x for wrap in part.wraps for x in (wrap, f"{prefix}_{wrap}_{form}"))
        plain["wraps"] += [x for x in wraps if x in there and x not in plain["wraps"]]
        for end, width, calls in ((form, part.width, part.calls), ("core", _CORE, [])):
            cuts = {f"{prefix}_{cut}_{end}": many for cut, many in _CUTS[width].items()}
            plain["cuts"] |= {cut: many for cut, many in cuts.items() if cut in there}
            for function, arguments, after in [*_basics(width), *calls]:
                told = {"function": f"{prefix}_{function}_{end}", "arguments": arguments}
                told |= {"after": after} if after else {}
                if told["function"] in there and told not in plain["calls"]:
                    plain["calls"].append(told)
    text = json.dumps(plain, indent=1)
    text = re.sub(r"\[\s+(-?\d+),\s+(-?\d+)\s+\]", r"[\1, \2]", text)
    return {f"{prefix}{RANGES}": f"{text}\n".encode("ascii")}


def _around(most: int) -> list[int]:
    return [-most, most]


def _format(width: int) -> str:
    return "q15" if width == 16 else "q31"


def _basics(width: int) -> list[Call]:
    """What all headers may have of codes of a width."""
    turn = {name: _around(full_scale(width)) for name in ("cosine", "sine")}
    given: dict[str, dict[str, Any]] = {
        "rotation": {"theta": "any"},
        "clarke": {"x": "any"},
        "clarke_inverse": {"x": "any"},
        "park": {"x": "any", "turn": turn},
        "park_inverse": {"x": "any", "turn": turn},
        "root": {"x": [0, (1 << (2 * width - 1)) - 1]},
        "word_root": {"x": "any"},
        "halvings": {"a": "any", "most": [_HALVED, _HALVED]},
    }
    return [(name, arguments, {}) for name, arguments in given.items()]


def _control_part(fit: IntegerFit, upper: str) -> _Part:
    """The control of rotor coordinates, or of each phase."""
    if not isinstance(fit, FixedControlFit):
        return _phase_part(fit.control, upper)
    control = fit.control
    return _Part("control", control.width, _states(control), _calls(control, upper), ("turn",))


def _any_code(kind: str, ends: list[int]) -> bool:
    """Whether a range holds every number of a type of C."""
    return ends[1] - ends[0] + 1 >= 1 << int(kind.strip("uint_"))


def _observer_part(observer: FixedPositionObserver, upper: str) -> _Part:
    """A position observer, whose words keep within the ranges of its method."""
    f, code = observer.format, observer.method.code
    own, gains = f"{code}_{f}", f"{upper}_{code.upper()}_GAINS_{f.upper()}"
    state: dict[str, Any] = {}
    for word, limit in zip(
        observer.method.words, observer.method.limits(observer.gains), strict=True
    ):
        name, _, entry = word.name.partition("[")
        ends = [limit.low, limit.high]
        if entry:
            state.setdefault(name, []).append(ends)
        elif not _any_code(word.type, ends):
            record, _, member = name.partition(".")
            state |= {record: state.get(record, {}) | {member: ends}} if member else {name: ends}
    start = {"observer": "any", "theta_e": "any", "omega_m": "any"}
    calls: list[Call] = [
        (f"{code}_start", start, {"observer": own}),
        (f"{code}_step", {"gains": gains, "observer": own, "v": "any", "i": "any"}, {}),
    ]
    return _Part("observer", observer.width, {own: state}, calls, ("predicted", "turned_by"))


def _phase_part(control: FixedPhaseControl, upper: str) -> _Part:
    """The control of each phase, from rest, with any phase open."""
    top, own = control.top, f"control_{control.format}"
    axes = (control.d, control.q, control.zero)
    state: dict[str, Any] = {
        "integral": [_around(0 if each is None else top << each.fraction) for each in axes],
        **({"harmonic": _around(top << control.harmonic_fraction)} if control.harmonics else {}),
        **_speed_state(control),
    }
    gains = f"{upper}_CONTROL_GAINS_{control.format.upper()}"
    measured: Any = {"v_m": [0, top]} if control.midpoint else "any"
    calls: list[Call] = [
        ("zero", {"x": "any"}, {}),
        ("sinusoids", {"gains": gains, "torque": "any"}, {}),
        ("control_start", {"state": "any"}, {"state": own}),
        ("open_phase", {"state": own, "phase": "any"}, {}),
        ("shaped_control", _given(gains, own, measured, "torque", "constant"), {}),
        *_control_calls(gains, own, measured),
    ]
    wraps = ("place", "later", "turned", "middle")
    return _Part("control", control.width, {own: state}, calls, wraps)


def _speed_state(control: FixedControl | FixedPhaseControl) -> dict[str, Any]:
    """What the speed loop keeps."""
    return {
        "speed": {"integral": _around(speed_loop_gains(control).speed.most)},
        "filtered": _around(control.top << (control.width - 2)),
        "count": [0, max(control.ratio - 1, 0)],
    }


def _given(gains: str, own: str, measured: Any, *rest: str) -> dict[str, Any]:
    """Arguments of a function of the control; all but what is measured can be any code."""
    return {"gains": gains, "state": own, "measured": measured} | dict.fromkeys(rest, "any")


def _control_calls(gains: str, own: str, measured: Any) -> list[Call]:
    """What is called at every sample."""
    speed = {"gains": gains, "state": own, "omega_m": "any", "reference": "any"}
    return [
        ("current_control", _given(gains, own, measured, "reference"), {}),
        ("speed_loop", speed, {}),
        ("torque_control", _given(gains, own, measured, "torque"), {}),
        ("speed_control", _given(gains, own, measured, "speed_reference"), {}),
    ]


def _states(control: FixedControl) -> dict[str, Any]:
    """What each state always lies in; members that are not named are any code."""
    gains = control.gains
    found: dict[str, Any] = {
        f"control_{control.format}": {
            "d": {"integral": _around(gains.d.most)},
            "q": {"integral": _around(gains.q.most)},
            **_speed_state(control),
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


def _calls(control: FixedControl, upper: str) -> list[Call]:
    """Functions of the control in rotor coordinates."""
    f, top = control.format, control.top
    end = f.upper()
    whole = f"{upper}_CONTROL_GAINS_{end}"
    error, limit = _around((1 << control.width) - 1), [0, top]
    own = f"control_{f}"
    found: list[Call] = [
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
    found.append(("control_start", {"state": "any"}, {"state": own}))
    return [*found, *_control_calls(whole, own, "any")]
