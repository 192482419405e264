"""Questions on a data sheet: asked again until the reader accepts, taken back, explained, left."""

from __future__ import annotations

from pathlib import Path

import pytest

from dqforge.machines.design.sheet_judged import checked_text
from dqforge.reports.command_line.designs import Dialogue, asked_sheet

PLAIN = {
    "name": "Hub motor",
    "pole-pairs": "15",
    "kv": "60 rpm/V",
    "torque-constant": "",
    "v-dc": "48 V",
    "max-current": "40 A rms",
    "resistance": "100 mOhm ll",
    "inductance": "200 uH ll",
    "switching-frequency": "",
    "max-speed": "",
    "rated-torque": "",
    "rated-speed": "",
    "rated-current": "",
    "inertia": "",
    "friction": "",
}


class Person:
    """Answers by the name in the prompt; several answers to one name in their order."""

    def __init__(self, **answers: str | list[str]) -> None:
        given = PLAIN | {name.replace("_", "-"): text for name, text in answers.items()}
        self.answers = {
            name: list(text) if isinstance(text, list) else [text] for name, text in given.items()
        }
        self.prompts: list[str] = []
        self.told: list[str] = []

    def ask(self, prompt: str) -> str:
        name = prompt.split(maxsplit=1)[0]
        self.prompts.append(name)
        return self.answers[name].pop(0)

    def run(
        self, known: dict[str, str] | None = None, *, needed_only: bool = False
    ) -> dict[str, str]:
        dialogue = Dialogue(self.ask, self.told.append, known or {}, needed_only=needed_only)
        return dialogue.run()

    def heard(self, words: str) -> bool:
        return any(words in line for line in self.told)


def test_plain_answers_make_a_design() -> None:
    person = Person()
    values = person.run()
    assert person.prompts == list(PLAIN)
    assert values["machine.max_current"] == "40 A rms"
    assert set(values) == {
        "name", "machine.pole_pairs", "machine.kv", "inverter.v_dc", "machine.max_current",
        "machine.resistance", "machine.inductance",
    }  # fmt: skip
    assert "name: Hub motor" in checked_text(values)


def test_a_wrong_answer_is_refused_at_once_and_asked_again() -> None:
    person = Person(v_dc=["48 A", "", "48 V"], resistance=["100 mH ll", "100 mOhm ll"])
    values = person.run()
    assert person.prompts.count("v-dc") == 3
    assert person.heard("expected a voltage such as '48 V', got '48 A' which is a current")
    assert person.heard("a design needs it; e.g. 48 V")
    assert person.heard("expected a resistance")
    assert values["inverter.v_dc"] == "48 V"


def test_an_open_convention_is_asked_for() -> None:
    person = Person(resistance="100 mOhm", max_current="40 A", number=["2", "3", ""])
    values = person.run()
    assert values["machine.max_current"] == "40 A rms"
    assert values["machine.resistance"] == "100 mOhm line-to-line"
    assert person.heard("expected a number from 1 to 2")
    assert person.heard("1 line-to-line: between two terminals")


def test_a_back_emf_constant_without_its_kind_is_asked_for_it() -> None:
    person = Person(
        kv="",
        back_emf_constant=["60 V", "60 V/krpm"],
        torque_constant="0.95 Nm/Arms",
        number=["1"],
        v_dc="540 V",
        resistance="1.2 Ohm ll",
        inductance="5 mH ll",
    )
    values = person.run()
    assert person.prompts.count("number") == 1
    assert values["machine.back_emf_constant"] == "60 V/krpm line-to-line rms"


def test_a_contradiction_is_told_at_once_and_an_earlier_answer_taken_back() -> None:
    person = Person(
        kv=["60 rpm/V", "26 rpm/V"],
        torque_constant=["0.45 Nm/Arms", "<", "0.45 Nm/Arms"],
        v_dc="100 V",
    )
    values = person.run()
    assert person.prompts[2:7] == [
        "kv",
        "torque-constant",
        "torque-constant",
        "kv",
        "torque-constant",
    ]
    assert person.heard("contradict each other by the factor 2.31")
    assert values["machine.kv"] == "26 rpm/V"


def test_nothing_is_before_the_first_question() -> None:
    person = Person(name=["<", "x"])
    assert person.run()["name"] == "x"
    assert person.heard("this is the first question")


def test_a_value_left_out_comes_back_with_the_question() -> None:
    person = Person(torque_constant=["", "0.1949 Nm/Arms"], v_dc=["<", "48 V"])
    assert person.run()["machine.torque_constant"] == "0.1949 Nm/Arms"


def test_what_is_implausible_is_told_and_kept_or_not() -> None:
    # kept: the drop, the sampling against a time constant of 20 us, the speed
    person = Person(
        resistance=["100 Ohm ll", "10 Ohm ll"], keep=["no", "", "", ""], max_speed="5000 rpm"
    )
    values = person.run()
    assert person.answers["keep"] == []
    assert person.heard("the drop over it at the current limit, over v_dc/sqrt(3), is 10200 %")
    assert person.heard("at 5000 rpm the back-EMF between two terminals peaks at 83.333 V")
    assert (values["machine.resistance"], values["machine.max_speed"]) == ("10 Ohm ll", "5000 rpm")
    assert len({line for line in person.told if "implausible" in line}) == len(
        [line for line in person.told if "implausible" in line]
    )


def test_a_question_mark_explains() -> None:
    person = Person(torque_constant=["?", ""], inertia=["?", ""])
    person.run()
    assert person.heard("A Kt computed as 9.55/Kv is that of direct current")
    assert person.heard("rms: per ampere r.m.s.")
    assert person.heard("without it there is none")


def test_only_what_is_needed_is_asked_for_beside_options() -> None:
    known = {
        "machine.kv": "60 rpm/V",
        "inverter.v_dc": "48 V",
        "machine.inductance_d": "0.1 mH phase",
    }
    person = Person(inductance_q="0.12 mH phase")
    values = person.run(known, needed_only=True)
    assert person.prompts == ["pole-pairs", "max-current", "resistance", "inductance-q"]
    assert "name" not in values


def test_without_a_terminal_nothing_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("builtins.input", lambda _: pytest.fail("asked"))
    assert asked_sheet(Path("nowhere"), {}, asking=True) == {}
    assert asked_sheet(Path("nowhere"), {"machine.kv": "60 rpm/V"}, asking=False) == {
        "machine.kv": "60 rpm/V"
    }
