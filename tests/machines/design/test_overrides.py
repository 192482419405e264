"""Keys set from outside: the design is that of a file edited by hand, and so is every refusal."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from design_changes import Change, permitted, wrong

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import SOURCE, load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.files.positioned_yaml import written

TEMPLATE = catalogue.template()


def load(*settings: str) -> Design:
    return load_text(TEMPLATE, "t.yaml", settings=settings)


def without_origin(design: Design) -> Design:
    """A design without what tells where it comes from."""
    values = tuple(replace(value, source="") for value in design.values)
    return replace(design, values=values, digest="", given=None, places=None)


def outcome(text: bytes, *settings: str) -> Design | str:
    """The design, or what the refusal says without its place and without the key before it."""
    try:
        return without_origin(load_text(text, "t.yaml", settings=settings))
    except DqforgeError as error:
        return error.message


def by_option(change: Change) -> str:
    value: Any = change.value
    return f"{'.'.join(map(str, change.path))}={written(value)}"


def compared(change: Change) -> bool:
    """Whether a change is one that an option can say in the same way."""
    inner: Any = change.base
    for part in change.path:
        if isinstance(inner, dict):
            inner = inner.get(part, {})
        elif isinstance(inner, list) and isinstance(part, int):
            inner = inner[part]
        else:
            return False  # a key into a single value
    return not change.leave_out and change.value is not None


def check_equal(change: Change) -> str:
    hand = outcome(change.text)
    option = outcome(TEMPLATE, by_option(change))
    if isinstance(hand, Design):
        assert option == hand, change.what
        return "valid"
    assert isinstance(option, str), change.what
    section = change.base.get(str(change.path[0]))
    for part in change.path[1:-1]:
        section = section.get(part) if isinstance(section, dict) else section
    # Of a section that lacks other keys too, the first complaint is that on the key that was set;
    # an option has no line below it.
    said = hand.replace("write its keys indented below", "write {key: value, ...}")
    said = re.sub(
        r"(unknown key '(\w+)'; it belongs in ([\w.]+).*), check the indentation",
        r"\1, write --set \3.\2=...",
        said,
    )
    assert section is None or said.endswith(option), f"{change.what}: {said!r} is not {option!r}"
    return "refused"


ALL = [change for change in (*permitted("template"), *wrong("template")) if compared(change)]


def test_a_key_that_is_set_is_one_that_was_edited() -> None:
    found = [check_equal(change) for change in ALL[::53]]
    assert len(ALL) > 1000
    assert min(found.count("valid"), found.count("refused")) > 5


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_every_key_that_is_set_is_one_that_was_edited(part: int) -> None:
    """Each key of the schema with all its words and ends, and each key of the
    template with wrong values.
    """
    for change in ALL[part::4]:
        check_equal(change)


def test_what_is_set_has_the_command_line_as_its_source() -> None:
    found = load("machine.resistance=12 mOhm", "losses.points.1.speed=3000 rpm", "machine.poles=8")
    sources = {value.path for value in found.values if value.source == SOURCE}
    assert sources == {"machine.resistance", "losses.points[1].speed", "machine.poles"}
    assert found.machine.r_s == 0.012
    own = load("machine.resistance={value: 1 Ohm, source: bridge}", "machine.rated={torque: 1 N m}")
    told = {value.path: value.source for value in own.values if value.source}
    assert told == {"machine.resistance": f"{SOURCE}: bridge", "machine.rated.torque": SOURCE}


def test_both_sides_of_a_deviation_have_one_source() -> None:
    found = load("control.tolerances.l_d={from: -10 %, to: 5 %, source: x}")
    told = [value.source for value in found.values if value.path.startswith("control.tolerances")]
    assert told == [f"{SOURCE}: x"] * 2


def test_a_value_replaces_the_kind_and_the_origin_too() -> None:
    entry = (
        b"resistance: {value: 4 Ohm, kind: line-to-line, source: sheet, note: cold, inferred: true}"
    )
    text = TEMPLATE.replace(b"resistance: 2.35 Ohm", entry)
    for setting, used in (
        ("machine.resistance=6 Ohm", 6.0),
        ("machine.resistance=6 Ohm line-to-line", 3.0),
        ("machine.resistance.value=6 Ohm", 3.0),  # whose kind stands beside it still
    ):
        found = load_text(text, "t.yaml", settings=[setting])
        value = next(value for value in found.values if value.path == "machine.resistance")
        assert (found.machine.r_s, value.source, value.inferred) == (used, SOURCE, False)
        told = any("machine.resistance is taken as a phase" in each for each in found.assumptions)
        assert told == (used == 6.0)
        assert "cold" not in value.note
    kept = load_text(text, "t.yaml", settings=["machine.resistance.note=warm"])
    value = next(value for value in kept.values if value.path == "machine.resistance")
    assert (value.source, kept.machine.r_s) == ("sheet", 2.0)


@pytest.mark.parametrize("entry", [b"20 A rms", b"{value: 20 A, kind: rms, source: plate}"])
def test_a_current_that_is_set_is_a_peak_unless_it_says_rms(entry: bytes) -> None:
    text = TEMPLATE.replace(b"max_current: 6.4 A", b"max_current: " + entry)
    assert text != TEMPLATE
    for written_value, peak in (("8 A", 8.0), ("8.0", 8.0), ("8 A rms", 8.0 * 2.0**0.5)):
        found = load_text(text, "t.yaml", settings=[f"machine.max_current={written_value}"])
        assert found.machine.i_max == pytest.approx(peak)
        told = any("machine.max_current is taken as a peak" in each for each in found.assumptions)
        assert told == ("rms" not in written_value)


def test_a_constant_that_is_set_without_its_kind_is_refused_as_in_a_file() -> None:
    entry = b"\n  back_emf_constant: 1 V/krpm line-to-line rms"
    text = TEMPLATE.replace(b"\n  magnet_flux: 0.06 Wb", entry)
    with pytest.raises(InputError, match="the kind is missing"):
        load_text(text, "t.yaml", settings=["machine.back_emf_constant=60 V/krpm"])


def test_the_text_that_is_kept_reads_as_the_same_design() -> None:
    found = load("fit.degree=3", "machine.resistance=12 mOhm", "field_weakening.speed=3000 rpm",
                 "losses.strategies=[mtpa]", "about='a: b # c'")  # fmt: skip
    assert found.given is not None
    again = load_text(found.given.text, "t.yaml")
    assert again == found
    assert found.given.text.count(b"#") >= TEMPLATE.count(b"#")
    assert load().given == load_text(TEMPLATE, "t.yaml").given


def test_the_order_of_options_is_of_no_meaning() -> None:
    settings = ["fit.degree=3", "fit.segments=2", "machine.poles=8", "control.tolerances.r_s=10 %"]
    first, *others = [load(*order) for order in itertools.permutations(settings)][::6]
    assert all(other == first for other in others)
    for pair in itertools.permutations(
        ("machine.rated.torque=1 N m", "machine.rated={speed: 5 rpm}")
    ):
        with pytest.raises(
            InputError, match=r"^--set machine\.rated\.torque: machine\.rated is set as well"
        ):
            load(*pair)


REFUSED = [
    ("machine.resistance", "--set: expected key=value, got 'machine.resistance'; write e.g."),
    ("machine.resistance: 3 Ohm", "--set: expected key=value"),
    ("=3", "--set: '=3' has no key"),
    ("a..b=3", "--set: 'a..b=3' has an empty part"),
    (".=3", "--set: '.=3' has an empty part"),
    ("machine.resistance=", "--set machine.resistance: there is no value behind '='"),
    ("machine.resistance=~", "--set machine.resistance: there is no value"),
    ("machine.resitance=1 Ohm", "--set machine.resitance: unknown key 'resitance'; did you mean"),
    ("machin.poles=8", "--set machin.poles: unknown key 'machin'; did you mean 'machine'"),
    ("machine.resistance=12 V", "--set machine.resistance: expected a resistance"),
    ("machine.resistance=12000", "--set machine.resistance: 12000 Ohm is outside"),
    ("machine.poles=7", "--set machine.poles: 7 poles cannot be"),
    ("machine.resistance.kind=phase", "machine.resistance is '2.35 Ohm' and has no keys"),
    ("machine.resistance.value=1 Ohm", "write --set machine.resistance=..."),
    ("machine.poles.a.b=1", "--set machine.poles.a.b: machine.poles is "),
    ("losses.points.2.torque=1 N m", "losses.points is a list of 2 entries, numbered from 0"),
    ("losses.points.x.torque=1 N m", "losses.points is a list of 2 entries, numbered from 0"),
    ("losses.points.00.torque=1 N m", "losses.points is a list"),
    (f"losses.points.{'9' * 100}.torque=1", "losses.points is a list"),
    ("name=!!python/object/apply:os.system [ls]", "--set name: tags such as"),
    ("name=&a x", "--set name: anchors"),
    ("name=*a", "--set name: references"),
    ("name=a: b", "--set name: ': ' and '- ' start a mapping or a list"),
    ("name=- a", "--set name: ': ' and '- ' start"),
    ("name=a #b", "--set name: '#b' behind the value is not read"),
    ("name=a\n---\nb", "--set name: a second document"),
    ("name='a", "--set name: a quoted text is not closed"),
    ("machine={<<: 1}", "--set machine: merge keys"),
    ("machine={a: 1, a: 2}", "--set machine: the key 'a' is given twice"),
    ("machine=" + "[" * 5000, "--set machine: nested deeper than 32 levels"),
    ("machine=" + "x" * 20_000, "the value has 20000 characters; write at most"),
    (".".join("a" * 40) + "=1", "is no key of a design"),
    ("x" * 5000 + "=1", "is no key of a design"),
    ("name=\udcff", "--set name: the character U+DCFF is not text"),
    ("machine.a\x1bb=1", "--set machine.a"),
    ("field_weakening.degree=3", "--set field_weakening.degree: "),
    ("machine.torque_constant={value: 1 N m/A, kind: rms}", "constant: magnet_flux 0.06 Wb"),
    ("dqforge=2", "--set dqforge: this program reads version 1"),
    ("machine.flux_map.file=x.csv", "--set machine.flux_map.file: "),
    ("fit=3", "--set fit: expected a section"),
    ("inverter={v_dc: 1 V}", "--set inverter: "),
]  # fmt: skip


@pytest.mark.parametrize(("setting", "said"), REFUSED, ids=[setting[:40] for setting, _ in REFUSED])
def test_what_is_refused_names_its_option_on_one_line(setting: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load(setting)
    text = str(caught.value)
    assert said in text
    assert text.startswith("--set")
    assert "\n" not in text
    assert len(text) < 450


def test_the_same_key_twice_is_refused() -> None:
    with pytest.raises(InputError, match=r"^--set machine\.poles: the key is set twice"):
        load("machine.poles=8", "machine.poles=8")
    with pytest.raises(InputError, match="set twice"):
        load("losses.points[0].torque=1 N m", "losses.points.0.torque=1 N m")


def test_a_refusal_of_the_file_keeps_its_line() -> None:
    """What the option did not set stands where it stood, whatever was set before it."""
    broken = TEMPLATE.replace(b"degree: 2", b"degree: 20")
    line = 1 + broken.decode().split("degree: 20")[0].count("\n")
    for setting in (
        "machine.resistance=12 mOhm",
        "machine.back_emf_constant={value: 1 V/krpm, kind: phase rms}",
    ):
        with pytest.raises(InputError, match=rf"^t\.yaml:{line}:\d+: fit\.degree"):
            load_text(broken, "t.yaml", settings=[setting])
    assert load_text(broken, "t.yaml", settings=["fit.degree=2"]).fit.degree == 2


def test_a_refusal_of_the_solver_names_the_option() -> None:
    from dqforge.optimizer.solution import solve

    with pytest.raises(DqforgeError, match=r"^--set fit\.max_torque: "):
        solve(load("fit.max_torque=900 N m"))


def test_files_are_looked_for_beside_the_design(tmp_path: Path) -> None:
    path = tmp_path / "d.yaml"
    path.write_bytes(TEMPLATE)
    with pytest.raises(
        InputError, match=r"^--set losses\.mission: the file 'm\.csv'|^--set losses\.mission"
    ):
        load_design(path, ["losses.mission=m.csv"])
