"""The checker of ranges confirms what is emitted, and finds what is planted in it."""

from __future__ import annotations

import math
import random
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from planted_ranges import Files, certificate, narrowed_types, planted_texts, said, smaller_claims

from dqforge.checker import c_text, kit, nodes
from dqforge.checker import check_ranges as checker
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.machines.names import NumberFormat
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files
from dqforge.reports.verification.independent import check_independently
from dqforge.reports.verification.range_claims import range_files

DRIVE = "abb-ipmsm-2k2"
# Drives of which others are drawn.
FIRST = (DRIVE, "paper001-pmsm-bench", "paper000-ipmsm-100kw")
# Variables of 32 bits that 16 hold in the headers of DRIVE; of the polynomials for every argument.
CODES = {"across", "along", "back", "coarse_d", "coarse_q", "limit", "limited", "unit", "x"}
CODES |= {"p_1", "p_2", "p_3", "p_4", "asked", "size", "share", "i_d", "i_q", "omega"}
NONE = ("salient-phase-waveforms",)  # not in integers


def written(design: Design, formats: tuple[NumberFormat, ...]) -> Files:
    """Headers in fixed point and their certificate."""
    made = replace(design, export=replace(design.export, control=formats))
    solution = solve(made)
    files = emitted_files(solution)
    kept = {name: x for name, x in files.items() if re.search(r"_q(15|31)\.h$", name)}
    kept |= range_files(solution, files)
    return {name: content.decode("utf-8") for name, content in kept.items()}


@cache
def emitted(name: str, *formats: NumberFormat) -> Files:
    return written(catalogue.load(name), formats or ("q15", "q31"))


def test_the_checker_runs_alone(tmp_path: Path) -> None:
    files = emitted(DRIVE, "q15")
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    lines = check_independently(tmp_path).splitlines()
    assert lines[0] == (
        "confirmed: ranges in fixed point; not covered of ranges in fixed point: nothing"
    )
    assert lines[-2:] == [
        "confirmed: abb2k2_control_q15.h: no product and no sum exceeds 99.9977% of int32_t",
        "confirmed: abb2k2_reference_q15.h: no product and no sum exceeds 24.9229% of int32_t",
    ]
    assert all(line.startswith("confirmed: ") for line in lines[1:])
    control = files["abb2k2_control_q15.h"]
    (tmp_path / "abb2k2_control_q15.h").write_text(control.replace("x >> 7U", "x >> 6U"))
    with pytest.raises(VerificationError, match="rotation_q15, line 152: the index 128 to 129"):
        check_independently(tmp_path)


def ran(text: str, name: str, *given: Any) -> Any:
    """Ranges that a function of C returns."""
    code = c_text.Code()
    code.tokens = [(x, 1) for x in c_text.TOKEN.findall(text)] + [("", 1)]
    while code.next():
        code.declared()
    run = checker.Run(code, {}, [])
    numbers = [nodes.Node(low, high, kind) for low, high, kind in given]
    return nodes.spans(run.call(name, numbers))


# Functions of two numbers of 16 bits, compared with all that they return.
SMALL = (
    "return (x * y) + ((x > y) ? x : -y);",
    "return (x >> 2U) * (y + 3);",
    "if ((x < y) && (y != 0)) { return x; } return y - x;",
    "int32_t n = 0; int32_t s = (x >= 0) ? x : -x; while (s > 3) { s >>= 1U; ++n; } return n + y;",
    "const int32_t s = (x * x) + (y * y); if (s > 50) { return 0; } return x + y;",
    "return (x * 7) / 3;",
    (
        "uint32_t r = (uint32_t)(x * x); uint32_t n = 0U; uint32_t b = 256U;"
        " while (b > r) { b >>= 2; } while (b != 0U) { const uint32_t t = n + b; n >>= 1;"
        " if (r >= t) { r -= t; n += b; } b >>= 2; } return (int32_t)n + y;"
    ),
    "const int32_t d = (y < 1) ? 1 : y; const int32_t q = x / d; return (x - (q * d)) * 2;",
    "const int32_t d = (y < 2) ? 2 : y; return x - (x / d);",
    "const int32_t d = (y > 2) ? 2 : y; return (x & 5) + d;",
    "int32_t a[2][2] = { { x, y }, { 1, 2 } }; a[0][1] += a[1][0]; return a[0][0] - a[0][1];",
    "const int32_t z = x * 9000; const int16_t k = (int16_t)z; return (k == z) ? 1 : y;",
)


@pytest.mark.parametrize("body", SMALL)
def test_ranges_hold_every_value(body: str, tmp_path: Path) -> None:
    """What a compiler makes of the function lies within, for all arguments of small boxes."""
    text = f"static inline int32_t f(int32_t x, int32_t y) {{ {body} }}"
    draw = random.Random(body)
    for _ in range(20):
        ends = [sorted(draw.randint(-12, 12) for _ in range(2)) for _ in range(2)]
        low, high = ran(text, "f", *((*each, "int32_t") for each in ends))
        found = [
            evaluated(body, x, y)
            for x in range(ends[0][0], ends[0][1] + 1)
            for y in range(ends[1][0], ends[1][1] + 1)
        ]
        assert low <= min(found)
        assert max(found) <= high


def evaluated(body: str, x: int, y: int) -> int:
    """The same by hand."""
    root = abs(x)
    halvings = 0
    while root > 3:
        root, halvings = root >> 1, halvings + 1
    kept = (x * 9000 + 2**15) % 2**16 - 2**15
    return (
        x * y + (x if x > y else -y),
        (x >> 2) * (y + 3),
        x if x < y and y != 0 else y - x,
        halvings + y,
        0 if x * x + y * y > 50 else x + y,
        abs(x * 7) // 3 * (1 if x > 0 else -1),
        abs(x) + y,
        2 * int(math.copysign(abs(x) % max(y, 1), x)),
        x - int(math.copysign(abs(x) // max(y, 2), x)),
        (x & 5) + min(y, 2),
        x - (y + 1),
        1 if kept == x * 9000 else y,
    )[SMALL.index(body)]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("return x * 70000;", "a product can reach"),
        ("return x + 2147460000;", "a sum can reach"),
        ("return x << 3U;", "a left shift of a negative number"),
        ("return 1 >> (x & 63);", "a shift by 0 to 63"),
        ("return 3 >> 32U;", "a shift by 32"),
        (
            "const uint32_t k = (uint32_t)(x & 7); return (int32_t)(k - 3U);",
            "a difference can reach",
        ),
        ("int32_t a[2]; a[0] = x; return a[1];", "a value is used that may not be set"),
        ("const int32_t a[2] = { x, 1, 2 }; return a[0];", "a table has not 2 entries"),
        ("int16_t k = x * 2; return k;", "is more than int16_t holds"),
        ("int32_t k; return k;", "a value is used that may not be set"),
        ("while (x > -40000) { x -= 1; } return x;", "a difference can reach|may not end"),
        ("static const int16_t t[3] = { 1, 2, 3 }; return t[(x > 0) ? 3 : 0];", "leaves the table"),
        ("return 5 / x;", "is not understood"),
        ("return (int16_t)(x * 2);", "is more than int16_t holds"),
    ],
)
def test_what_leaves_its_type_is_a_fault(body: str, words: str) -> None:
    text = f"static inline int32_t f(int32_t x) {{ {body} }}"
    with pytest.raises(kit.Fault, match=words):
        ran(text, "f", (-32768, 32767, "int32_t"))


def only(files: Files, names: tuple[str, ...]) -> dict[str, Any]:
    """The certificate with the calls of some functions."""
    plain = certificate(files)
    plain["calls"] = [x for x in plain["calls"] if x["function"].split("_", 1)[1] in names]
    return plain


def test_planted_faults_of_short_functions_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of functions that take no time; the others when slow."""
    files = emitted(DRIVE, "q15")
    plain = only(files, ("clarke_q15", "clarke_inverse_q15", "reference_q15", "speed_loop_q15"))
    tried = 0
    for name, changed in planted_texts(files):
        if name.split(":")[0] in ("clarke", "clarke_inverse", "saturated", "shifts"):
            tried += 1
            assert "not confirmed: " in said(changed, tmp_path, capsys, plain)[-1], name
    assert tried == 7


@pytest.mark.slow
def test_planted_faults_in_headers_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = emitted(DRIVE, "q15")
    planted = list(planted_texts(files))
    assert len(planted) >= 45
    for name, changed in planted:
        line = said(changed, tmp_path, capsys)[-1]
        assert re.match(r"not confirmed: .*(, line \d+: |\.h|state\.|: it )", line), name


@pytest.mark.slow
def test_types_that_are_too_narrow_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Variables of 32 bits that hold a code alone may have 16."""
    files = emitted(DRIVE, "q15")
    kept = set()
    for name, changed in narrowed_types(files):
        line = said(changed, tmp_path, capsys)[-1]
        if not line.startswith("not confirmed: "):
            kept.add(name.split(": ")[1])
    assert kept == CODES


@pytest.mark.slow
def test_states_that_are_told_smaller_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = emitted(DRIVE, "q15")
    planted = list(smaller_claims(certificate(files)))
    assert len(planted) >= 20
    for name, plain in planted:
        line = said(files, tmp_path, capsys, plain)[-1]
        assert re.match(r"not confirmed: \w+: state\.\S+ may be ", line), name


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in catalogue.names() if name not in NONE])
def test_library_drives(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = said(emitted(name), tmp_path, capsys)
    assert lines[-1].startswith("confirmed: ")


@pytest.mark.slow
@pytest.mark.parametrize("number", range(10))
def test_drawn_drives(number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Drives whose parameters are up to twice or half of those of a library drive."""
    draw = random.Random(number)
    while True:
        base = catalogue.load(draw.choice(FIRST))
        assert isinstance(base.machine, LinearMachine)
        names = ("r_s", "l_d", "l_q", "psi_pm")
        values = {x: getattr(base.machine, x) * 2.0 ** draw.uniform(-1, 1) for x in names}
        try:
            files = written(replace(base, machine=replace(base.machine, **values)), ("q15", "q31"))
        except (InputError, NoSolutionError):
            continue
        break
    assert said(files, tmp_path, capsys)[-1].startswith("confirmed: ")
