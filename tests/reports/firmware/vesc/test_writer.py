"""VESC's files written: as its tool takes them, read back, merged into what is there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from firmware_asked import random_asked, scooter
from firmware_round_trips import kept_of, output_of

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.targets.vesc import configure
from dqforge.reports.firmware.target import FileTitle
from dqforge.reports.firmware.vesc import TARGET, read, write

TITLE = FileTitle("scooter", "hub -- of a scooter */ <!-- -->", "ab" * 32, "0.1", ("one remark",))

# What the tool knows of the keys, by its own list of parameters (res/config/7.01): kind of value
# (1 real, 2 whole, 4 one of several), least and most, the controller's value before.
PARAMETERS = {
    "motor_type": (4, 0, 2, 0),
    "l_current_max": (1, 0.0, 5000.0, 60.0),
    "l_current_min": (1, -5000.0, 0.0, -60.0),
    "l_abs_current_max": (1, 0.0, 5000.0, 150.0),
    "l_min_erpm": (1, -1e6, 0.0, -1e5),
    "l_max_erpm": (1, 0.0, 1e6, 1e5),
    "l_max_duty": (1, 0.0, 1.0, 0.95),
    "foc_current_kp": (1, 0.0, 1e5, 0.0123),
    "foc_current_ki": (1, 0.0, 1e5, 11.85),
    "foc_f_zv": (1, 0.0, 150000.0, 30000.0),
    "foc_dt_us": (1, 0.0, 1000.0, 0.12),
    "foc_pll_kp": (1, 0.0, 1e6, 2000.0),
    "foc_pll_ki": (1, 0.0, 1e6, 30000.0),
    "foc_motor_l": (1, 0.0, 10.0, 1.227e-05),
    "foc_motor_ld_lq_diff": (1, -10.0, 10.0, 3.77e-06),
    "foc_motor_r": (1, 0.0, 1000.0, 0.0118),
    "foc_motor_flux_linkage": (1, 0.0, 1000.0, 0.004014),
    "foc_observer_gain": (1, 0.0, 2e10, 6.206e07),
    "foc_control_sample_mode": (4, 0, 2, 0),
    "foc_cc_decoupling": (4, 0, 3, 0),
    "foc_mtpa_mode": (4, 0, 2, 0),
    "sp_pid_loop_rate": (4, 0, 8, 5),
    "s_pid_kp": (1, 0.0, 1e4, 0.004),
    "s_pid_ki": (1, 0.0, 1e4, 0.004),
    "s_pid_kd": (1, 0.0, 1e4, 0.0001),
    "s_pid_speed_source": (4, 0, 2, 0),
    "si_motor_poles": (2, 2, 254, 14),
}


def merged(xml: bytes) -> dict[str, float]:
    """What a controller holds after the tool has read the file: setXML, spelled out.

    Names that are missing keep their value, unknown ones are passed over; whole numbers by toInt
    and real ones by toDouble, which are 0 where the text is none.
    """
    held = {name: value for name, (_, _, _, value) in PARAMETERS.items()}
    root = ET.fromstring(xml)
    assert root.tag == "MCConfiguration"
    for element in root:
        assert element.tag in PARAMETERS, f"the tool would warn of {element.tag}"
        kind, least, most, _ = PARAMETERS[element.tag]
        text = element.text or ""
        if kind == 1:
            assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]\d\d)?", text), text
            value: float = float(text)
        else:
            assert re.fullmatch(r"-?\d+", text), text
            value = int(text)
        assert least <= value <= most
        held[element.tag] = value
    return held


def files() -> Iterator[tuple[Configuration, dict[str, bytes]]]:
    for asked in random_asked(200):
        found = configure(asked)
        yield found, write(found, TITLE, None)


def test_200_machines_come_back_from_both_files() -> None:
    for found, written in files():
        for name, content in written.items():
            assert kept_of(read(content.decode(), name)) == kept_of(found)


def test_the_tool_takes_200_files() -> None:
    for found, written in files():
        held = merged(written["scooter_mcconf.xml"])
        assert {name: held[name] for name in found.own} == found.own
        assert held["l_max_duty"] == 0.95  # not decided: stays the controller's


def test_the_scooters_files_say_what_the_firmware_was_tried_with() -> None:
    held = merged(write(configure(scooter()), TITLE, None)["scooter_mcconf.xml"])
    assert held["foc_current_kp"] == 0.628319
    assert held["foc_current_ki"] == 314.159
    assert held["foc_observer_gain"] == 2.66479e07
    assert held["foc_pll_ki"] == 1e6
    assert held["si_motor_poles"] == 30


def test_same_input_same_bytes_without_dates() -> None:
    first = write(configure(scooter()), TITLE, None)
    assert first == write(configure(scooter()), TITLE, None)
    for content in first.values():
        assert b"\r" not in content
        assert not re.search(rb"\b20\d\d-\d\d", content)


def test_remarks_cannot_leave_their_comment() -> None:
    title = FileTitle(
        "scooter", "x", "ab" * 32, "0.1", ("--> <foc_motor_r>9</foc_motor_r> */ int",)
    )
    written = write(configure(scooter()), title, None)
    assert merged(written["scooter_mcconf.xml"])["foc_motor_r"] == 0.05
    assert read(written["scooter_mcconf.h"].decode(), "a.h").drive.r_s == 0.05


FOREIGN = """<?xml version="1.0" encoding="UTF-8"?>
<!-- saved by hand -->
<MCConfiguration>
    <ConfigVersion>2</ConfigVersion>
    <foc_motor_r>0.011</foc_motor_r><!-- measured -->
    <foc_f_sw>25000</foc_f_sw>
    <l_battery_cut_start>44.2</l_battery_cut_start>
    <motor_description>&lt;p&gt;any text&lt;/p&gt;</motor_description>
    <foc_pll_ki/>
    <of_a_later_version>3</of_a_later_version>
</MCConfiguration>
"""


def test_foreign_fields_of_xml_survive() -> None:
    found = configure(scooter())
    text = write(found, TITLE, FOREIGN)["scooter_mcconf.xml"].decode()
    before, after = ET.fromstring(FOREIGN), ET.fromstring(text)
    values = {element.tag: element.text for element in after}
    for name in ("ConfigVersion", "l_battery_cut_start", "motor_description", "of_a_later_version"):
        assert values[name] == next(element.text for element in before if element.tag == name)
    order = [element.tag for element in before]
    assert [element.tag for element in after][: len(order)] == order
    for comment in ("<!-- saved by hand -->", "<!-- measured -->", "&lt;p&gt;any text"):
        assert comment in text
    assert values["foc_f_sw"] == "40000"
    assert "foc_f_zv" not in values
    assert kept_of(read(text, "a.xml")) == kept_of(found)


BOARD = """#ifndef BOARD_H_
#define BOARD_H_
#define MCCONF_L_MAX_VOLTAGE 72 // of the capacitors
#define MCCONF_FOC_MOTOR_R   0.011f /* measured */
#define HW_LIM_CURRENT -300.0, 300.0
#ifndef MCCONF_FOC_CURRENT_KP
#define MCCONF_FOC_CURRENT_KP 0.3
#endif
#endif /* BOARD_H_ */
"""


def test_foreign_macros_of_a_header_survive() -> None:
    found = configure(scooter())
    text = write(found, TITLE, BOARD)["scooter_mcconf.h"].decode()
    lines = text.splitlines()
    assert "#define MCCONF_L_MAX_VOLTAGE 72 // of the capacitors" in lines
    assert "#define MCCONF_FOC_MOTOR_R   0.05 /* measured */" in lines
    assert "#define HW_LIM_CURRENT -300.0, 300.0" in lines
    assert lines[-1] == "#endif /* BOARD_H_ */"
    assert text.count("MCCONF_FOC_CURRENT_KP") == 2
    assert kept_of(read(text, "a.h")) == kept_of(found)


def test_a_header_without_guard_gets_what_is_missing_at_its_end() -> None:
    text = write(configure(scooter()), TITLE, "#define MCCONF_FOC_MOTOR_R 1\n#if A\n#endif\n")
    lines = text["scooter_mcconf.h"].decode().splitlines()
    assert lines[:3] == ["#define MCCONF_FOC_MOTOR_R 0.05", "#if A", "#endif"]
    assert lines[-1] == "#define MCCONF_SI_MOTOR_POLES 30"


def test_existing_files_that_are_damaged_are_refused() -> None:
    with pytest.raises(InputError):
        write(configure(scooter()), TITLE, FOREIGN[:-20])


def test_the_header_is_c(tmp_path: Path) -> None:
    """Included before another value, as before mcconf_default.h, ours counts."""
    found = configure(scooter())
    header = write(found, TITLE, None)["scooter_mcconf.h"]
    (tmp_path / "scooter_mcconf.h").write_bytes(header)
    prints = "\n".join(
        f'    printf("%s %.9g\\n", "{name}", (double)({name}));'
        for name in re.findall(rb"#define (MCCONF_\w+) ", header)
        for name in [name.decode()]
    )
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "scooter_mcconf.h"\n#ifndef MCCONF_FOC_MOTOR_R\n'
        "#define MCCONF_FOC_MOTOR_R 0.015\n#endif\nint main(void)\n{\n" + prints + "\n"
        "    return 0;\n}\n"
    )
    output = output_of(tmp_path, "main.c")
    values = dict(line.split() for line in output.splitlines())
    assert float(values["MCCONF_FOC_MOTOR_R"]) == 0.05
    assert float(values["MCCONF_FOC_OBSERVER_GAIN"]) == 2.66479e07
    assert len(values) == len(found.own)


def test_the_target_is_whole() -> None:
    assert TARGET.method.name == "vesc"
    written = TARGET.write(configure(scooter()), TITLE, None)
    assert all(TARGET.recognise(name, content.decode()) for name, content in written.items())


def test_a_lower_limit_of_braking_stays() -> None:
    found = configure(scooter())
    largest = float(found.own["l_current_max"])
    existing = (
        f"#define MCCONF_L_CURRENT_MIN {-0.2 * largest}\n#define MCCONF_L_MAX_ABS_CURRENT "
        f"{9.0 * largest}\n#define MCCONF_FOC_MOTOR_R 1.0\n"
    )
    files = write(found, TITLE, existing)
    text = next(text.decode() for name, text in files.items() if name.endswith(".h"))
    back = read(text, "mcconf.h")
    assert back.own["l_current_min"] == -0.2 * largest
    assert back.own["l_abs_current_max"] == found.own["l_abs_current_max"]
