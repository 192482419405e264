"""Faults planted in headers in fixed point, and in what is claimed of their ranges."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

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


def planted_texts(files: dict[str, str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Name of a fault and the headers with it; each is planted once."""
    for place, text, name in _TEXTS:
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
        for key, each in value.items() if isinstance(value, dict) else ():
            if isinstance(each, list):
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
