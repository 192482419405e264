"""Faults planted in headers in fixed point, and in what is claimed of their ranges, and what the
checker says of them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dqforge.checker import check_ranges as checker
from dqforge.reports.verification.range_claims import RANGES

Files = dict[str, str]


def certificate(files: Files) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(next(x for y, x in files.items() if y.endswith(RANGES)))
    return plain


def said(
    files: Files, folder: Path, capsys: pytest.CaptureFixture[str], plain: Any = None
) -> list[str]:
    """The lines that the checker prints."""
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    path = folder / next(name for name in files if name.endswith(RANGES))
    if plain is not None:
        path.write_text(json.dumps(plain))
    capsys.readouterr()
    code = checker.main([str(path)])
    lines = capsys.readouterr().out.splitlines()
    assert code == (1 if lines[-1].startswith("not confirmed: ") else 0)
    return lines


# A place of the text, what is put there, and how it is called; Q15.
_TEXTS = (
    (r"theta & 16383U", "theta & 32767U", "rotation"),
    (r"x >> 7U\)", "x >> 6U)", "rotation"),
    (r"= 127 - ", "= 128 - ", "rotation"),
    (r"\* \(int32_t\)rest\) \+ 64\) >> 7U", "* (int32_t)rest) + 64) >> 6U", "rotation"),
    (r"32767U\n    \};", "32769U\n    };", "rotation"),
    (r"0U, 402U,", "0U, 60402U,", "rotation"),
    (r"\* 2\) - x\.b - x\.c\) \* 10923", "* 2) - x.b - x.c) * 20923", "clarke"),
    (r"- x\.c\) \* 18919", "- x.c) * 38919", "clarke"),
    (r"\(int32_t\)x\.beta \* 28378", "(int32_t)x.beta * 68378", "clarke_inverse"),
    (r"\(kept == x\) \? kept", "(kept != x) ? kept", "saturated"),
    (r"\(x < 0\) \? -32768 : 32767", "(x < 0) ? -32768 : 32768", "saturated"),
    (r"\* -58155\) >> 15U\)", "* -58155) >> 9U)", "reciprocal"),
    (r"1073741824 - \(m \* p_3\)", "2073741824 - (m * p_3)", "reciprocal"),
    (r"s >> 14U, 1U", "s >> 13U, 1U", "inverse_root"),
    (r"1610612736 - \(", "1910612736 - (", "inverse_root"),
    (r"t \* p_4, 14U\)", "t * p_4, 15U)", "inverse_root"),
    (r"14U\);\n\}\n\n/\* A voltage", "13U);\n}\n\n/* A voltage", "inverse_root"),
    (r"size > 32766", "size > 65534", "shortened"),
    (r"whole < 536870912\b", "whole < 536870913000", "shortened"),
    (r"whole \*= 4", "whole *= 8", "shortened"),
    (r"uint32_t bits = 16U", "uint32_t bits = 15U", "shortened"),
    (r"coarse_d \* share, 14U", "coarse_d * share, 13U", "shortened"),
    (r"coarse_q \* share, 14U", "coarse_q * share, 13U", "shortened"),
    (r"most > 32759\) \? 32759", "most > 32767) ? 32767", "current_control"),
    (r"x > 32768\) \? 32768", "x > 65568) ? 65568", "duty"),
    (r"\(x < 0\) \? 0 : \(\(x", "(x < -1) ? 0 : ((x", "duty"),
    (r"link < 16384", "link < 0", "shares"),
    (r"link \*= 2", "link *= 1", "shares"),
    (r"uint32_t places = 15U", "uint32_t places = 3U", "shares"),
    (r"8192, 536854528 \},", "8192, 936854528 },", "gains"),
    (r"    14189,\n", "    0,\n", "gains"),
    (r"\{ 18919, 14U, 8192 \}", "{ 78919, 14U, 8192 }", "gains"),
    (r"\{ 29491, 20U, 524288 \}", "{ 29491, 32U, 524288 }", "gains"),
    (r"    10U\n\};", "    11U\n};", "gains"),
    (r"\{ 25889, 6U, 32 \}", "{ 95889, 6U, 32 }", "observer"),
    (r"1073709056", "2073709056", "observer"),
    (r"i\.q, 15U\)\);\n    result\.q", "i.q, 0U));\n    result.q", "decoupling"),
    (r"limited - output\)", "limited - 40000 * output)", "pi_step"),
    (r"step = 4U", "step = 8U", "reference"),
    (r"reference_torque_q15\[row \+ 1U\] -", "reference_torque_q15[row + 2U] -", "reference"),
    (r"\* 16384\) / ", "* 163840) / ", "reference"),
    (r"\{ -7390, 31924 \}", "{ -7390, 51924 }", "reference"),
    (r"reaches 99\.9977%", "reaches 99.9877%", "said"),
    (r"reaches 24\.9229%", "reaches 1.9229%", "said"),
    (r"!= \(-1\)\n#error", "!= (-2)\n#error", "shifts"),
)
# In position observers; Q15.
OBSERVERS = (
    (r"moved & 1073741823U", "moved & 2147483647U", "rotation"),
    (r"x \* x, 27U", "x * x, 17U", "rotation"),
    (r"nearly > 2147483647\)", "nearly > 2147483648)", "rotation"),
    (r"x\.alpha \* 65536", "x.alpha * 131072", "widened"),
    (r"uint32_t bit = 1073741824U", "uint32_t bit = 4294967295U", "word_root"),
    (r"(bit = 1073741824U;(?:\n.*)+?)rest >= trial", r"\1rest + 1U >= trial", "word_root"),
    (r"(bit = 1073741824U;(?:\n.*)+?)root >>= 1", r"\1root <<= 1", "word_root"),
    (r"alpha >> 16U", "alpha >> 15U", "sine_of_angle"),
    (r"\(uint32_t\)x_2 \+ \(uint32_t\)y_2", "(uint32_t)(x_2 + y_2)", "sine_of_angle"),
    (r"\(length < floor\) \? floor", "(length > floor) ? floor", "sine_of_angle"),
    (r"across - \(first \* size\)", "across - (first * floor)", "sine_of_angle"),
    (r"\(first \* size\)\) \* 32768", "(first * size)) * 65536", "sine_of_angle"),
    (r"\(int64_t\)first \* 32768", "first * 32768", "sine_of_angle"),
    (r"within_core\(a, 2147483647\)", "within_core(a, 2147483648)", "clipped"),
    (r"\(int64_t\)a \* b, 31U", "a * b, 31U", "times"),
    (r"\(int64_t\)a \* b, 31U", "(int64_t)a * b, 30U", "times"),
    (r"omega, 16U\), 32767", "omega, 16U), 32768", "omega_m"),
    (r"32768U\) >> 16U", "32768U) >> 15U", "theta_e"),
    (r"reaches 100\.0000%", "reaches 99.9999%", "said"),
    (r"!= \(-1\)\n#error", "!= (-2)\n#error", "shifts"),
    (r"\(int64_t\)last\.alpha \+ i\.alpha", "last.alpha + i.alpha", "change"),
    (r"\(int64_t\)i\.alpha - last\.alpha", "i.alpha - last.alpha", "change"),
    (r"\(int64_t\)model - own", "model - own", "pulled"),
    (r"\{ 1720004902, 33U", "{ 1720004902, 10U", "gains"),
    (r"\{ 1720004902, 33U", "{ 2720004902, 33U", "gains"),
    (r"33U, INT64_C\(4294967296\) \}", "33U, INT64_C(9223372036854775807) }", "gains"),
    (r"    1593,\n", "    0,\n", "gains"),
    (r"    7288378,\n", "    2147483647,\n", "gains"),
)
# Of the Kalman filter alone, and of Matsui's voltage model.
KALMAN = (
    (r"bits \+= 8U", "bits += 32U", "halvings"),
    (r"rows\[10\]\[4\]", "rows[10][3]", "polynomials"),
    (r"rows\[9\], square", "rows[10], square", "polynomials"),
    (r"\(p >> bits\) \* factor", "p * factor", "weighted"),
    (r"& \(\(\(int64_t\)1 << bits\) - 1\)", "& ((int64_t)1 << 62U)", "weighted"),
    (r"part & 2147483647", "part & INT64_C(1125899906842623)", "gain_of"),
    (r"short_d < 67108864\) \? 67108864", "short_d < 0) ? 0", "division"),
    (r"INT64_C\(72057594037927936\)", "INT64_C(9223372036854775807)", "state"),
    (r"p_q01 <= INT64_C\(36028797018963968\)", "p_q01 <= INT64_C(36028797018963969)", "state"),
    (r"\(p_q12 >= INT64_C\(-36028797018963968\)\)", "(p_q12 <= 1)", "state"),
    (r"INT64_C\(1939816651084\)", "INT64_C(9193981665108400000)", "gains"),
)
MATSUI = (
    (r"34359738368\)\);", "34359738369));", "state"),
    (r"observer->integral = integral", "observer->integral = integral + 1", "state"),
)
# In the control of each phase, four legs in the frame dqy; Q15.
PHASES = (
    (r"theta \* 96", "theta * 98", "flux"),
    (r"index \+ 1\]", "index + 2]", "flux"),
    (r"later_b >= 96", "later_b >= 98", "flux"),
    (r"later_c - 96", "later_c - 30", "flux"),
    (r"int32_t place =", "int16_t place =", "flux"),
    (r"\+ x\.c\) \* 10923", "+ x.c) * 30923", "zero"),
    (r"zero, 4458, 131072", "zero, 0, 131072", "torque_currents"),
    (r"\(plane\), 1, 65536", "(plane), 0, 65536", "frame"),
    (r"half_whole \* 16384", "half_whole * 65536", "frame"),
    (r"= \(\(flux\.alpha \* flux\.alpha\) >> 2U\)", "= (flux.alpha * flux.alpha * 3)", "frame"),
    (r"axes\[2\]\.alpha =", "axes[3].alpha =", "frame"),
    (r"axes\[2\]\.alpha =", "axes[0].alpha =", "frame"),
    (r"k < 3U", "k < 4U", "frame_errors"),
    (r"held\[k\] \* 16384", "held[k] * 163840", "frame_voltage"),
    (r"int32_t phase\[3\];", "int32_t phase[2];", "phases"),
    (r"v\.alpha \* 16384", "v.alpha * 131072", "phases"),
    (r"phase\[2\] =", "phase[1] =", "phases"),
    (r"most \* 32768", "most * 1048576", "fitting"),
    (r"\* 32768\) / v_dc", "* 65540) / v_dc", "duties"),
    (r"12015, 32767\)", "0, 32767)", "duties"),
    (r"uint16_t\)\(\(x < 0\)", "uint16_t)((x < -1)", "duty"),
    (r"saturated_q15\(v_5\.alpha >> 3U\)", "rounded_q15(v_5.alpha, 0U)", "shortened"),
    (r"state\[0\] =", "state[2] =", "harmonic_update"),
    (r"weight\)\),\n        536854528", "weight)),\n        536854529", "harmonic_update"),
    (r"32767 << gains->d\.fraction", "32768 << gains->d.fraction", "state"),
    (r"32767 << gains->zero\.fraction", "32768 << gains->zero.fraction", "state"),
    (r"count >= gains->ratio", "count > gains->ratio", "state"),
    (r"14U\)\),\n        536854528", "14U)),\n        536854529", "state"),
    (r"\{ 21961, 15U", "{ 81961, 15U", "gains"),
    (r"14U, \{ 27962", "31U, { 27962", "gains"),
    (r"reaches 99\.9977%", "reaches 99.9976%", "said"),
)


def planted_texts(
    files: dict[str, str], texts: tuple[tuple[str, str, str], ...] = _TEXTS
) -> Iterator[tuple[str, dict[str, str]]]:
    """Name of a fault and the headers with it; each is planted once."""
    for place, text, name in texts:
        for file, content in files.items():
            changed = re.sub(place, text, content, count=1)
            if file.endswith(".h") and changed != content:
                yield f"{name}: {place}", files | {file: changed}


def narrowed_types(files: dict[str, str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Variables of 32 bits that get 16, one at a time."""
    for file, content in files.items():
        for found in re.finditer(r"(?<=const )int32_t(?= (\w+) ?=)", content):
            changed = content[: found.start()] + "int16_t" + content[found.end() :]
            row = content.count("\n", 0, found.start()) + 1
            yield f"{file}, line {row}: {found[1]}", files | {file: changed}


def smaller_claims(plain: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Certificates in which one end of a state is told nearer to zero."""

    def ends(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            if isinstance(each, list) and isinstance(each[0], int):
                yield from ((*path, key, end) for end in (0, 1) if each[end])
            else:
                yield from ends(each, (*path, key))

    for path in ends(plain["states"], ()):
        changed = json.loads(json.dumps(plain))
        at = changed["states"]
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] -= 1 if path[-1] else -1
        yield ".".join(map(str, path)), changed
