"""XML of others: nothing from outside, lines for complaints, values replaced where they stand."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.c_macros import elements, parsed_xml, with_attribute, with_texts

FILE = """<?xml version="1.0" encoding="UTF-8"?>
<MC>
  <!-- kept -->
  <r unit="Ω">0.05</r>
  <empty/>
  <name>a &amp; b</name>
  <vars><var name="Rs" value = '0.35' kind="x"/><var value="1"/></vars>
</MC>
"""

LAUGHS = (
    '<!DOCTYPE lolz [<!ENTITY a "lol">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9))
    + "]>\n<MC>&j;</MC>"
)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (LAUGHS, 1, "document type"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd">\n<a/>', 1, "document type"),
        ('<!DOCTYPE a [<!ENTITY x SYSTEM "http://h/">]>\n<a>&x;</a>', 1, "document type"),
        ("<a>\n&x;</a>", 2, "not XML"),
        ("<a>\n<b></a>", 2, "not XML"),
        ("<a" + "><a" * 40 + ">", 1, "levels"),
        ("<a>" + "<b/>" * 60_000 + "</a>", 1, "elements"),
        ("<a/>\n<b/>", 2, "not XML"),
        ("<a b='1' b='2'/>", 1, "not XML"),
    ],
)
def test_hostile_texts_are_refused_in_one_line(text: str, line: int, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        parsed_xml(text, "f.xml")
    assert refused.value.line == line
    assert "\n" not in str(refused.value)


def test_a_text_that_was_decoded_counts_whatever_it_claims() -> None:
    text = '<?xml version="1.0" encoding="UTF-16"?>\n<a>Ω</a>'
    assert parsed_xml(text, "f.xml").text == "Ω"


def test_elements_have_their_lines_in_the_order_of_the_text() -> None:
    found = [(part.tag, part.line) for part in elements(parsed_xml(FILE, "f.xml"))]
    wanted = [("MC", 2), ("r", 4), ("empty", 5), ("name", 6), ("vars", 7), ("var", 7), ("var", 7)]
    assert found == wanted


def test_values_are_replaced_where_they_stand_and_nothing_else() -> None:
    new = with_texts(FILE, "f.xml", {"r": "0.1", "empty": "2 < 3", "further": "é"})
    before, after = FILE.split("\n"), new.split("\n")
    assert after[3] == '  <r unit="Ω">0.1</r>'
    assert after[4] == "  <empty>2 &lt; 3</empty>"
    assert after[7:] == ["    <further>é</further>", "</MC>", ""]
    assert [after[k] for k in (0, 1, 2, 5, 6)] == [before[k] for k in (0, 1, 2, 5, 6)]
    tree = ElementTree.fromstring(new.encode())
    assert {part.tag: part.text for part in tree if part.tag != "vars"} == {
        "r": "0.1",
        "empty": "2 < 3",
        "name": "a & b",
        "further": "é",
    }


def test_an_empty_root_is_opened() -> None:
    assert with_texts("<MC/>", "f.xml", {"r": "1"}) == "<MC>\n    <r>1</r>\n</MC>"


def test_an_element_with_children_takes_no_value() -> None:
    with pytest.raises(InputError, match="vars holds elements") as refused:
        with_texts(FILE, "f.xml", {"vars": "1"})
    assert refused.value.line == 7


def test_attributes_are_replaced_where_they_stand() -> None:
    first = parsed_xml(FILE, "f.xml").children_named("vars")[0].children[0]
    new = with_attribute(FILE, "f.xml", "value", {first.start: 'a "b" <c>'})
    assert new == FILE.replace("'0.35'", "'a \"b\" &lt;c&gt;'")
    again = parsed_xml(new, "f.xml").children_named("vars")[0].children[0]
    assert again.attributes == {"name": "Rs", "value": 'a "b" <c>', "kind": "x"}
