"""Macros and assignments of C headers, against what a compiler makes of them."""

from __future__ import annotations

import random
import shutil
import subprocess
from pathlib import Path

import pytest

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.c_macros import read_assignments, read_macros, with_values

HEADER = """/* one
 * #define HIDDEN 1 */
#ifndef GUARD_H
#define GUARD_H
#define M1_PP (2) // pole pairs
#define M1_RS (0.45F) /* Ohm */
#define M1_LD 375e-6f
#define TWICE (M1_RS * 2.0F) + 1
#define CAST ((float)(M1_PP) / 3)
#define WHOLE (7 / 2)
#define SHIFT (1 << 4 | 1)
#define HEX 0x1FUL
#define LONG \\
    (1.0 + \\
     2.0)
#define FRAC FRAC16(0.25)
#define WORD other_word
#define LIST {-1412, 5}
#define CALLED(x) ((x) + 1)
#define TEXT "a /* b" /* c */
#define NEGATIVE -3
#define CHOICE (M1_PP > 1 ? 5 : 6)
#define AGAIN 1
#define AGAIN 2
#define GONE 1
#undef GONE
#endif
"""


def test_macros_have_texts_lines_and_values() -> None:
    found = read_macros(HEADER, "m1.h", {"FRAC16": lambda x: round(x * 32768) / 32768})
    values = {name: found.value(name) for name in found}
    assert values == {
        "GUARD_H": None,
        "M1_PP": 2,
        "M1_RS": 0.45,
        "M1_LD": 375e-6,
        "TWICE": 1.9,
        "CAST": pytest.approx(2.0 / 3.0),
        "WHOLE": 3,
        "SHIFT": 17,
        "HEX": 31,
        "LONG": 3.0,
        "FRAC": 0.25,
        "WORD": None,
        "LIST": None,
        "CALLED": None,
        "TEXT": None,
        "NEGATIVE": -3,
        "CHOICE": 5,
        "AGAIN": 2,
    }
    assert found.line("M1_RS") == 6
    assert found.line("LONG") == 13
    assert found.text("LIST") == "{-1412, 5}"
    assert found.whole("M1_PP") == 2
    assert found.number("NONE") is None
    assert "HIDDEN" not in found


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("WORD", "m1.h:17: WORD is 'other_word', not a number; write one"),
        ("TEXT", "m1.h:20: TEXT is"),
    ],
)
def test_a_macro_that_is_no_number_is_refused_with_its_line(name: str, message: str) -> None:
    found = read_macros(HEADER, "m1.h")
    with pytest.raises(InputError) as refused:
        found.number(name)
    assert str(refused.value).startswith(message)


def test_what_is_missing_or_no_whole_number_is_refused() -> None:
    found = read_macros("#define A 1.5\n", "a.h")
    with pytest.raises(InputError, match=r"B is missing; write '#define B' and a number"):
        found.needed("B")
    with pytest.raises(InputError, match=r"a.h:1: A is 1.5; write a whole number"):
        found.whole("A")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("#if 0\n#define A 1\n#else\n#define A 2\n#endif\n", 2),
        ("#ifdef B\n#define A 1\n#else\n#define A 2\n#endif\n", 2),
        ("#ifndef B\n#define A 1\n#endif\n", 1),
        ("#define B 3\n#if (B == 2)\n#define A 1\n#elif (B == 3)\n#define A 2\n#endif\n", 2),
        ("#define B x\n#if (B == y)\n#define A 1\n#elif (B == x)\n#define A 2\n#endif\n", 2),
        ("#if defined(B) && !defined C\n#define A 1\n#else\n#define A 2\n#endif\n", 2),
        ("#if UNKNOWN > 3\n#define A 1\n#else\n#define A 2\n#endif\n", 1),
        ("#if 1\n#if 0\n#else\n#define A 4\n#endif\n#else\n#define A 5\n#endif\n", 4),
        ("#if 0\n#if 1\n#define A 4\n#endif\n#endif\n#define A 7\n", 7),
    ],
)
def test_conditions_choose_as_far_as_the_file_says(text: str, wanted: int) -> None:
    assert read_macros(text, "a.h").value("A") == wanted


def test_branches_that_do_not_count_are_there_all_the_same() -> None:
    found = read_macros("#if 0\n#define A 1\n#else\n#define A 2\n#endif\n", "a.h")
    assert [(part.text, part.taken, found.value_of(part)) for part in found.every] == [
        ("1", False, 1),
        ("2", True, 2),
    ]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("#define A 1\n/* open\n", 2, "comment is not closed"),
        ("/*/", 1, "comment is not closed"),
        ("\n#if 1\n#define A 1\n", 2, "no #endif"),
        ("#define A 1\n#endif\n", 2, "#endif without #if"),
        ("#if 1\n" * 70 + "#endif\n" * 70, 65, "nested conditions"),
        ("".join(f"#define A{k} 1\n" for k in range(20_002)), 20_001, "macros"),
    ],
)
def test_hostile_headers_are_refused_in_one_line(text: str, line: int, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        read_macros(text, "a.h")
    assert refused.value.line == line
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "text",
    [
        "".join(f"#define A{k} A{k + 1} + A{k + 1}\n" for k in range(60)) + "#define A60 1\n",
        "#define A0 A1\n#define A1 A0\n",
        "#define A0 A0\n",
        "".join(f"#define A{k} A{k + 1}\n" for k in range(5000)) + "#define A5000 1\n",
        "#define A0 " + "(" * 5000 + "1" + ")" * 5000 + "\n",
        "#define A0 " + "-" * 5000 + "1\n",
        "#define A0 " + "1+" * 5000 + "1\n",
        "#define A0 (1 << 100)\n",
        "#define A0 (1 / 0)\n",
        "#define A0 1e308 * 1e308\n",
        "#define A0 " + "9" * 5000 + "\n",
        "#define A0 9999999999 * 9999999999 * 9999999999\n",
        "#define A0 __import__(1)\n",
        "#define A0 a.b\n",
        "#define A0 1 +\n",
        "#define A0 (1\n",
        "#define A0\n",
        "#define A0 1 ? 2\n",
        "#define A0 (float)\n",
        "#define A0 FRAC16()\n",
        "#define A0 FRAC16(1, 2)\n",
    ],
)
def test_what_is_no_bounded_arithmetic_has_no_value(text: str) -> None:
    found = read_macros(text, "a.h", {"FRAC16": lambda x: x})
    assert found.value("A0") is None


def test_long_lines_of_quotes_take_no_time() -> None:
    """A pattern that goes back at every quote would take hours."""
    hostile = ('"\\' * 400_000, "'" + "\\'" * 400_000, "/" * 800_000, "/*" * 400_000 + "*/")
    for text in hostile:
        assert list(read_macros(f"#define A 1\n#define B 2 //{text}\n", "a.h")) == ["A", "B"]


def test_other_values_stand_where_the_old_ones_did() -> None:
    found = read_macros(HEADER, "m1.h")
    new = with_values(HEADER, found, {"M1_RS": "(0.5F)", "LONG": "4", "NONE": "1", "AGAIN": "3"})
    wanted = HEADER.replace("(0.45F)", "(0.5F)").replace("#define AGAIN 2", "#define AGAIN 3")
    wanted = wanted.replace("(1.0 + \\\n     2.0)", "4")
    assert new == wanted
    assert read_macros(new, "m1.h").value("LONG") == 4


def test_an_empty_macro_gets_a_value() -> None:
    text = "#define A\n#define B /* b */\n"
    assert with_values(text, read_macros(text, "a.h"), {"A": "1", "B": "2"}) == (
        "#define A 1\n#define B /* b */ 2\n"
    )


def test_assignments_are_read_and_replaced() -> None:
    text = (
        "params.motor.lq = 28.0E-6f; // [H] = x;\nparams.motor.P=14;\n"
        "if (a == b) { p->k[3] = 1 + 2; }\n"
        "params.motor.r = HZ(2.0f) /* y */;\n"
    )
    found = read_assignments(text, "p.c", {"HZ": lambda x: 10.0 * x})
    assert {name: (found.value(name), found.line(name)) for name in found} == {
        "params.motor.lq": (28e-6, 1),
        "params.motor.P": (14, 2),
        "p->k[3]": (3, 3),
        "params.motor.r": (20.0, 4),
    }
    new = with_values(text, found, {"params.motor.lq": "1.0f", "params.motor.r": "3.0f"})
    assert new == text.replace("28.0E-6f", "1.0f").replace("HZ(2.0f)", "3.0f")


def _expression(generator: random.Random, depth: int) -> str:
    if depth == 0:
        return generator.choice(["3", "7U", "2.5", "0.125f", "1e-2", "0x1F", "B", "C", "-4"])
    one, two = (_expression(generator, depth - 1) for _ in range(2))
    form = generator.choice(["{}+{}", "({})*({})", "({})-({})", "(({})/({}))", "(float)({})+{}"])
    return form.format(one, two)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
def test_values_are_those_of_the_compiler(tmp_path: Path) -> None:
    """300 random macros over each other, against what gcc computes of them in double precision."""
    generator = random.Random(11)
    lines = ["#define B 5", "#define C 3.5"]
    lines += [f"#define A{k} {_expression(generator, generator.randrange(4))}" for k in range(300)]
    found = read_macros("\n".join(lines) + "\n", "a.h")
    known = [name for name in found if found.value(name) is not None]
    assert len(known) > 250
    text = "\n".join(lines).replace("0.125f", "0.125").replace("(float)", "(double)")
    prints = "\n".join(f'printf("%.17g\\n", (double)({name}));' for name in known)
    program = f"#include <stdio.h>\n{text.replace('7U', '7')}\nint main(void) {{\n{prints}\n}}\n"
    (tmp_path / "a.c").write_text(program)
    compiled = ["gcc", "-w", "-std=c99", "-o", str(tmp_path / "a"), str(tmp_path / "a.c")]
    subprocess.run(compiled, check=True)
    out = subprocess.run([str(tmp_path / "a")], check=True, capture_output=True, text=True).stdout
    wanted = [float(line) for line in out.split()]
    assert [found.value(name) for name in known] == pytest.approx(wanted, rel=1e-12)


def test_a_text_of_the_same_number_stays() -> None:
    text = "#define A (350.0F)\n#define B FRAC16(0.5)\n#define C (1.5F)\n"
    macros = read_macros(text, "h.h", functions={"FRAC16": float})
    changed = with_values(text, macros, {"A": "350", "B": "(0.5F)", "C": "1.25"})
    assert changed == "#define A (350.0F)\n#define B (0.5F)\n#define C 1.25\n"
