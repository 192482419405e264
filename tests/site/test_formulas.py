"""Formulas become MathML as GitHub shows them, spaced as TeX spaces them, and what cannot be
converted is told.
"""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from docutils import nodes
from docutils.utils import new_document
from mathml import JoinPunctuation, mathml


def test_lines_of_equations_stand_below_each_other_without_numbers() -> None:
    made = mathml(r"\begin{aligned} a &= b \\ c &= d + e \end{aligned}", block=True)
    assert made.count("<mtr>") == 2
    assert made.count('<mtd columnalign="right">') == 2
    assert made.count('<mtd columnalign="left">') == 2
    assert "mtext" not in made  # no numbers of equations


def test_a_subscript_of_several_letters_is_one_word() -> None:
    assert "<mi>cu</mi>" in mathml("P_{cu}", block=False)
    assert "<mrow><mi>d</mi><mo>,</mo><mi>k</mi></mrow>" in mathml("i_{d,k}", block=False)


def test_vectors_are_bold_in_every_browser() -> None:
    made = mathml(r"\mathbf A \mathbf z \boldsymbol\psi \boldsymbol x", block=False)
    assert [each in made for each in "\U0001d400\U0001d433\U0001d74d\U0001d499"] == [True] * 4
    assert "mathvariant" not in made


def test_primes_stand_beside_their_letters_and_bars_keep_their_size() -> None:
    beside = '<mrow><mi>L</mi><mo lspace="0em" rspace="0em">\u2032</mo></mrow>'
    assert f"<msub>{beside}<mi>d</mi></msub>" in mathml("L_d'", block=False)
    assert beside in mathml("L'", block=True)
    assert mathml(r"a \lvert x\rvert", block=False).count('stretchy="false">|</mo>') == 2
    assert mathml(r"\left\lvert x\right\rvert", block=False).count('stretchy="true"') == 2


def test_a_sign_belongs_to_what_follows_an_operator() -> None:
    for formula in ("-a", "b = -a", "(-a, b)", r"b \le -a", "[-a"):
        assert '<mo form="prefix">\u2212</mo>' in mathml(formula, block=False), formula
    for formula in ("b - a", r"\lvert b\rvert - a", "b_1 - a", "f(b) - a"):
        assert "<mo>\u2212</mo>" in mathml(formula, block=False), formula


def test_punctuation_stays_with_its_formula() -> None:
    document, paragraph = new_document("page"), nodes.paragraph()
    document += paragraph
    formula, single = nodes.math("", "x"), nodes.math("", "y")
    paragraph += [nodes.Text("a ("), formula, nodes.Text("), b "), single, nodes.strong("", "c")]
    JoinPunctuation(document).run()
    assert (formula["before"], formula["after"]) == ("(", "),")
    assert [each.astext() for each in paragraph] == ["a ", "x", " b ", "y", "c"]
    assert "before" not in single
    assert "after" not in single


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


@pytest.mark.parametrize("formula", [r"\unheard x", r"a & b", r"\begin{aligned} a"])
def test_what_the_converter_does_not_know_is_refused(formula: str) -> None:
    with pytest.raises(ValueError, match=r"known to the converter|Error"):
        mathml(formula, block=True)
