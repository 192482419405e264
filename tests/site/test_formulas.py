"""Formulas of the pages as MathML: spaced as TeX spaces them."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from mathml import mathml


def _tree(formula: str) -> ElementTree.Element:
    return ElementTree.fromstring(mathml(formula, block=True))


def _spaced(formula: str) -> str:
    """Leaves of a formula, thin spaces between them as underscores."""
    leaves = [leaf for leaf in _tree(formula).iter() if len(leaf) == 0]
    return "".join("_" if leaf.tag == "mspace" else leaf.text or "" for leaf in leaves)


@pytest.mark.parametrize(
    ("formula", "spaced"),
    [
        (r"\psi \sin 15", "\u03c8_sin_15"),
        (r"2 \cos(x)", "2_cos(x)"),
        (r"(a) \ln x", "(a)_ln_x"),
        (r"\sin^2 x + \arg z", "sin2_x+arg_z"),
        (r"\operatorname{sat}\frac{a}{b}", "sat_ab"),
        (r"\operatorname{sat}\left(a\right)", "sat(a)"),
        (r"a \exp\,b", "a_exp_b"),
        (r"\ln\lvert x\rvert", "ln_|x|"),
        (r"x = \min(a, b)", "x=min(a,b)"),
    ],
)
def test_functions_stand_apart(formula: str, spaced: str) -> None:
    assert _spaced(formula) == spaced


def test_names_of_functions_are_no_operators() -> None:
    assert [leaf.text for leaf in _tree(r"\operatorname{artanh} x").iter("mo")] == []


def test_names_of_one_letter_are_upright() -> None:
    (name,) = _tree(r"\operatorname{E}[X]").iterfind(".//mi[@class]")
    assert (name.text, name.get("mathvariant")) == ("E", "normal")


def test_capitals_of_greek_are_upright() -> None:
    letters = {leaf.text: leaf.get("mathvariant") for leaf in _tree(r"\Delta \psi").iter("mi")}
    assert letters == {"\u0394": "normal", "\u03c8": None}


def test_bars_open_and_close() -> None:
    bars = list(_tree(r"\lvert a\rvert^2 < \lvert b\rvert").iter("mo"))
    assert [bar.get("form") for bar in bars if bar.text == "|"] == [
        "prefix",
        "postfix",
        "prefix",
        "postfix",
    ]


def test_hats_sit_on_their_letter() -> None:
    assert [leaf.text for leaf in _tree(r"\hat{\theta}").iter("mo")] == ["\u02c6"]


@pytest.mark.parametrize("formula", [r"\unknown x", r"a & b"])
def test_what_is_not_known_is_refused(formula: str) -> None:
    with pytest.raises(ValueError, match=r"not known|not well-formed"):
        mathml(formula, block=False)
