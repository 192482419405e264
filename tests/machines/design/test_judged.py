"""What is said of values alone and of those that are known so far together."""

from __future__ import annotations

import pytest
from data_sheets import SCOOTER, SERVO

from dqforge.machines.design.sheet_judged import checked_text, read_alone, remarks_so_far
from dqforge.machines.errors import InputError


@pytest.mark.parametrize(
    ("key", "text", "words"),
    [
        ("machine.resistance", "100 mH", "expected a resistance such as"),
        ("machine.resistance", "100 Ohm rms", "rms"),
        ("machine.inductance", "200", "has no unit; write '200 uH' or '200 mH'"),
        ("machine.kv", "60 V", "60 V"),
        ("machine.back_emf_constant", "60 V/krpm", "the kind is missing"),
        ("machine.pole_pairs", "seven", "expected a whole number"),
        ("machine.pole_pairs", "7.5", "expected a whole number"),
        ("inverter.v_dc", "48 A", "expected a voltage"),
        ("inverter.v_dc", "48,5 V", "write 48.5 V"),
        ("name", "a*/b", "C reads as code"),
        ("name", "x" * 81, "at most 80"),
    ],
)
def test_a_wrong_value_is_refused_in_the_words_of_the_reader(
    key: str, text: str, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_alone(key, text)
    assert words in caught.value.message
    assert not caught.value.message.startswith(key)
    assert "design.yaml" not in str(caught.value)


def grown(*keys: str, **changed: str) -> dict[str, str]:
    """The first values of the scooter, some of them others."""
    values = {key: SCOOTER.values[key] for key in keys}
    return values | {f"machine.{key}": text for key, text in changed.items()}


def test_odd_poles_and_contradictions_are_told_as_soon_as_they_can_be() -> None:
    with pytest.raises(InputError, match="15 poles cannot be"):
        remarks_so_far({"machine.poles": "15"})
    known = grown("machine.pole_pairs", "machine.kv")
    # Kt of sinusoidal currents is sqrt(3)/2 of 60/(2 pi Kv) per ampere peak
    right = 0.5 * 3**0.5 * 60.0 / (2.0 * 3.141592653589793 * 60.0)
    assert remarks_so_far(known | {"machine.torque_constant": f"{right} N m/A peak"}) == []
    with pytest.raises(InputError, match=r"contradict each other by the factor 1\.41"):
        remarks_so_far(known | {"machine.torque_constant": f"{right} N m/A rms"})


def test_the_drop_over_the_resistance_is_told_once_current_and_voltage_are_known() -> None:
    keys = ["machine.pole_pairs", "machine.kv", "inverter.v_dc", "machine.max_current"]
    (sentence,) = remarks_so_far(grown(*keys, resistance="10 Ohm ll"))
    # 5 Ohm times 56.6 A over 27.7 V
    assert "machine.resistance: the drop over it at the current limit" in sentence
    assert "1020 %" in sentence
    assert remarks_so_far(grown(*keys, resistance="100 mOhm ll")) == []
    assert remarks_so_far(grown(*keys[:2], resistance="10 Ohm")) == []  # a share of nothing yet


def test_what_stands_in_is_never_told() -> None:
    """Whatever is known, in whatever order: sound values make no sentence."""
    for motor in (SCOOTER, SERVO):
        items = list(motor.values.items())
        for start in range(len(items)):
            turned = items[start:] + items[:start]
            for count in range(1, len(turned) + 1):
                assert remarks_so_far(dict(turned[:count])) == [], dict(turned[:count])


def test_the_speed_that_the_dc_link_allows_is_held_against_the_largest() -> None:
    (sentence,) = remarks_so_far(SCOOTER.values | {"machine.max_speed": "3000 rpm"})
    # 60 rpm per volt: at 3000 rpm 50 V between two terminals
    assert "peaks at 50 V, above v_dc = 48 V" in sentence
    assert remarks_so_far(SCOOTER.values | {"machine.max_speed": "2800 rpm"}) == []


def test_rated_torque_and_current_are_held_against_the_constants() -> None:
    plate = {"machine.rated.torque": "2.4 Nm", "machine.rated.current": "1.6 Arms"}
    values = SERVO.values | {"machine.max_current": "8 Arms"}
    assert remarks_so_far(values) == []
    (sentence,) = remarks_so_far(values | plate)
    assert (
        "machine.rated.current: the torque that it makes, over the rated torque, is 0.66"
        in sentence
    )
    with pytest.raises(InputError, match="is more than the"):
        remarks_so_far(SERVO.values | {"machine.rated.torque": "30 N m"})


def test_messages_on_a_whole_data_sheet_name_the_option() -> None:
    with pytest.raises(InputError, match=r'give --kv "190 rpm/V" --resistance'):
        checked_text(
            {
                key: text
                for key, text in SCOOTER.values.items()
                if "max" in key or "v_dc" in key or "pole" in key or "inductance" in key
            }
        )
    with pytest.raises(InputError) as caught:
        checked_text(SCOOTER.values | {"machine.resistance": "100 mH"})
    assert str(caught.value).startswith("--resistance: expected a resistance")
    with pytest.raises(InputError) as caught:
        checked_text(SCOOTER.values | {"machine.torque_constant": "0.5 N m/A rms"})
    assert str(caught.value).startswith("--torque-constant: ")
