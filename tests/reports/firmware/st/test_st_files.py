"""Files of ST's MCSDK: written and read back, put into those of others, and what is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from random_st_drives import base_design, random_asked, value

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.targets.st import ST
from dqforge.reports.firmware.st import TARGET
from dqforge.reports.firmware.target import FileTitle

TITLE = FileTitle("drive", "a drive", "0" * 64, "1", ("a remark",))

DRIVE_HEADER = """
/* a header of a project, in the layout that Workbench 6 writes */
#ifndef DRIVE_PARAMETERS_H
#define DRIVE_PARAMETERS_H
#define MAX_APPLICATION_SPEED_RPM           4000 /*!< rpm, mechanical */
#define M1_SS_MEAS_ERRORS_BEFORE_FAULTS     3 /*!< over
                                                two lines */
#define F1                                  16384
#define F2                                  1024
#define F1_LOG                              LOG2((16384))
#define GAIN1                               -24217
#define GAIN2                               26260
#define PLL_KP_GAIN                         213
#define PLL_KI_GAIN                         8
#define PLL_KPDIV                           16384
#define PLL_KPDIV_LOG                       LOG2((PLL_KPDIV))
#define PLL_KIDIV                           65535
#define PWM_FREQUENCY   20000
#define REGULATION_EXECUTION_RATE           1
#define ISR_FREQUENCY_HZ                    (PWM_FREQUENCY/REGULATION_EXECUTION_RATE)
#define PID_TORQUE_KP_DEFAULT               2312
#define PID_TORQUE_KI_DEFAULT               2158
#define PID_TORQUE_KD_DEFAULT               100
#define PID_FLUX_KP_DEFAULT                 2312
#define PID_FLUX_KI_DEFAULT                 2158
#define TF_KPDIV                            128
#define TF_KIDIV                            4096
#define TF_KPDIV_LOG                        LOG2((128))
#define PID_SPEED_KP_DEFAULT                3144/(SPEED_UNIT/10) /* for 0.1 Hz */
#define PID_SPEED_KI_DEFAULT                141/(SPEED_UNIT/10)
#define SPEED_LOOP_FREQUENCY_HZ             (uint16_t)1000 /*!<Execution rate */
#define SP_KPDIV                            1024
#define SP_KIDIV                            16384
#define IQMAX                               870
#define DEFAULT_CONTROL_MODE                MCM_SPEED_MODE
#define OBS_MINIMUM_SPEED_RPM               1440
#endif /*DRIVE_PARAMETERS_H*/
"""
MOTOR_HEADER = """
#ifndef PMSM_MOTOR_PARAMETERS_H
#define PMSM_MOTOR_PARAMETERS_H
#define POLE_PAIR_NUM          2 /* pairs */
#define RS                     0.35
#define LS                     0.0006
#define NOMINAL_CURRENT         870
#define MOTOR_MAX_SPEED_RPM     4000
#define MOTOR_VOLTAGE_CONSTANT  4.0
#define ID_DEMAG                -870
#endif
"""
STAGE_HEADER = """
#ifndef POWER_STAGE_PARAMETERS_H
#define POWER_STAGE_PARAMETERS_H
#define VBUS_PARTITIONING_FACTOR      0.09625565501973242
#define NOMINAL_BUS_VOLTAGE_V         24U
#define RSHUNT                        0.003
#define AMPLIFICATION_GAIN            9.14
#endif
"""


def project(*, structure: int = 1, topology: int = 1) -> str:
    """A project of Workbench 5 with the variables that are read, and others; ours."""
    values = {
        "Pole Pairs": 2,
        "Max Rated Speed": 4000,
        "Nominal Current": 2.1,
        "Nominal DC Voltage": 24,
        "Rs": 0.35,
        "Ld": 0.4,
        "Lq": 0.8,
        "Ls": 0.6,
        "B-EmfConstant": 4,
        "inertia": 4.407,
        "friction": 14.218,
        "Hall sensors": "true",
        "Nominal voltage": 12,
        "ICS gain": 0.05,
        "Shunt resistor(s) value": 0.01,
        "Amplifying network gain": 5.18,
        "PWM frequency": 20000,
        "Torque - P dividend": 2446,
        "Torque - P divisor": 128,
        "Torque - I dividend": 2283,
        "Torque - I divisor": 4096,
        "Flux - P dividend": 1223,
        "Flux - P divisor": 64,
        "Flux - I dividend": 2283,
        "Flux - I divisor": 4096,
        "Torque&amp;Flux - Manual editing enabled": "false",
        "SpeedCtrl - Execution rate": 2,
        "SpeedCtrl - P dividend": 85,
        "SpeedCtrl - P divisor": 16,
        "SpeedCtrl - I dividend": 60,
        "SpeedCtrl - I divisor": 256,
    }
    lists = {"I/SM-PMSM": (structure, "10"), "Current reading topology": (topology, "012")}
    lists["Torque&amp;Flux - Execution rate"] = (1, "12345")
    lines = [
        f'<var name="{name}" readonly="false" value="{value}"/>' for name, value in values.items()
    ]
    for name, (chosen, tags) in lists.items():
        items = "".join(f'<item tag="{tag}" text="x"/>' for tag in tags)
        lines.append(f'<var name="{name}" value="{chosen}"><items>{items}</items></var>')
    inner = "\n".join(lines)
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<STWorkBench>\n<systems><system type="motor 1">'
        f"<motor><vars>\n{inner}\n</vars></motor></system></systems>\n</STWorkBench>\n"
    )


def together(files: Sequence[tuple[str, str]]) -> Configuration:
    assert TARGET.read_several is not None
    return TARGET.read_several(files)


def written(found: Configuration) -> dict[str, str]:
    return {name: text.decode() for name, text in TARGET.write(found, TITLE, None).items()}


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_random_drives_come_back(count: int) -> None:
    for wish in random_asked(count, 17, tables=3):
        found = ST.configure(wish)
        files = written(found)
        back = together([(text, name) for name, text in files.items()])
        assert dict(back.own) == dict(found.own)
        assert back.drive == found.drive
        assert (back.current_d, back.current_q, back.speed) == (
            *(found.current_d, found.current_q, found.speed),
        )
        assert back.contradictions == found.contradictions
        assert back.version == found.version
        header = files["drive_st_parameters.h"]
        alone = TARGET.read(header, "drive_st_parameters.h")
        assert alone.current_q == found.current_q
        assert ST.profile(alone) == ST.profile(found)
        if "SEGDIV" in found.own:
            again = TARGET.write(found, TITLE, header)["drive_st_parameters.h"].decode()
            assert again == header
        assert max(len(line) for line in header.splitlines()) < 200


def test_an_independent_reader_finds_the_values() -> None:
    (wish,) = random_asked(1, 23, tables=1)
    found = ST.configure(wish)
    files = written(found)
    macros = dict(re.findall(r"^#define (\w+) +(\S+)", files["drive_st_parameters.h"], re.M))
    for name, stated in found.own.items():
        if name in ("inertia", "friction", "ld_lq_ratio"):
            continue
        text = macros[name].removesuffix("/(SPEED_UNIT/10)").strip("()")
        assert text == stated if isinstance(stated, str) else float(text) == stated
    assert macros["TF_KPDIV_LOG"] == f"LOG2(({found.own['TF_KPDIV']}))"
    motor = json.loads(files["drive_st_motor.json"])
    assert motor["ls"] == pytest.approx(1e3 * value(found, "LS"), rel=1e-6)
    assert motor["magneticStructure"] == {
        "type": "I-PMSM",
        "ld_lq_ratio": found.own["ld_lq_ratio"],
    }
    assert motor["polePairs"] == found.own["POLE_PAIR_NUM"]


def test_three_headers_of_a_project() -> None:
    texts = [(DRIVE_HEADER, "drive.h"), (MOTOR_HEADER, "motor.h"), (STAGE_HEADER, "stage.h")]
    assert all(TARGET.recognise(name, text) for text, name in texts)
    found = together(texts)
    assert found.version == "6"
    assert found.contradictions == ()
    assert found.current_q is not None
    assert found.current_q.kp / 0.0006 == pytest.approx(6003.3 * 2 / 3**0.5, rel=1e-4)
    assert found.drive.i_max == pytest.approx(870 / 32768 * 60.175, rel=1e-4)
    origin = found.origins["r_s"]
    assert (origin.key, origin.text, origin.line) == ("RS", "0.35", 5)
    assert found.origins["i_max"].key == "NOMINAL_CURRENT"
    alone = TARGET.read(DRIVE_HEADER, "drive.h")
    assert alone.current_q is None
    assert alone.drive.t_s == 5e-5
    old = DRIVE_HEADER.replace("MCM_SPEED_MODE", "STC_SPEED_MODE")
    assert TARGET.read(old, "drive.h").version == "5"


def test_values_stand_in_the_headers_of_a_project_and_all_else_stays() -> None:
    (wish,) = random_asked(1, 29)
    found = ST.configure(wish)
    merged = TARGET.write(found, TITLE, DRIVE_HEADER)["drive_st_parameters.h"].decode()
    kept = [line for line in DRIVE_HEADER.splitlines() if "KD_DEFAULT" in line or "LINE" in line]
    assert kept
    assert all(line in merged for line in kept)
    assert "/*!< over\n                                                two lines */" in merged
    assert "(SPEED_UNIT/10) /* for 0.1 Hz */" in merged
    assert "#define RS " not in merged
    full = 1.65 / (value(found, "RSHUNT") * value(found, "AMPLIFICATION_GAIN"))
    counts = round(value(found, "IQMAX_A") * 32768 / full)
    assert f"#define IQMAX                               {counts}\n" in merged
    assert f"LOG2(({found.own['TF_KPDIV']}))" in merged
    motor = TARGET.write(found, TITLE, MOTOR_HEADER)["drive_st_parameters.h"].decode()
    stage = TARGET.write(found, TITLE, STAGE_HEADER)["drive_st_parameters.h"].decode()
    assert "VBUS_PARTITIONING_FACTOR      0.09625565501973242" in stage
    back = together([(merged, "d"), (motor, "m"), (stage, "s")])
    assert back.current_q == found.current_q
    assert back.current_d == found.current_d
    assert back.drive.r_s == found.drive.r_s
    assert back.drive.psi_pm == found.drive.psi_pm
    # a header without the macro of a value is left without it
    assert TARGET.write(found, TITLE, "#define RS 1\n")["drive_st_parameters.h"].decode() == (
        f"#define RS {found.own['RS']:.6g}\n"
    )


def test_the_motor_file_tells_henries_from_millihenries() -> None:
    content = {"polePairs": 7, "rs": 3.194, "ls": 0.8, "BEmfConstant": 3.31, "label": "gimbal"}
    found = TARGET.read(json.dumps(content), "motor.json")
    assert found.drive.l_q == 0.0008
    assert found.name == "gimbal"
    assert any("taken in mH" in words for words in found.conventions)
    assert found.origins["l_q"].line == 1
    profiler = TARGET.read(json.dumps(content | {"ls": 0.0006, "rs": 0.35}), "export.json")
    assert profiler.drive.l_q == 0.0006
    assert any("taken in H" in words for words in profiler.conventions)
    slow = content | {"ls": 1.0, "rs": 100.0, "description": "made by dqforge 1; ls in mH"}
    assert TARGET.read(json.dumps(slow), "ours.json").drive.l_q == 1e-3


def test_a_motor_file_keeps_its_foreign_keys_and_its_unit() -> None:
    (wish,) = random_asked(1, 31)
    found = ST.configure(wish)
    own = {"id": "m", "hallSensor": {"sensorsDisplacement": 120}, "polePairs": 3, "rs": 0.35}
    own |= {"ls": 0.0006, "BEmfConstant": 4.0}
    text = json.dumps(own, indent=4)
    merged = json.loads(TARGET.write(found, TITLE, text)["drive_st_motor.json"])
    assert merged["hallSensor"] == {"sensorsDisplacement": 120}
    assert merged["id"] == "m"
    assert merged["ls"] == found.own["LS"]
    assert merged["rs"] == found.own["RS"]


def test_a_project_of_workbench_5() -> None:
    found = TARGET.read(project(), "x.stmcx")
    assert found.version == "5"
    drive = found.drive
    assert (drive.pole_pairs, drive.r_s, drive.l_d, drive.l_q) == (2, 0.35, 0.0006, 0.0006)
    assert (drive.v_dc, drive.t_s, drive.t_speed) == (12.0, 1e-4, 2e-3)
    assert drive.inertia == pytest.approx(4.407e-6)
    assert found.current_d == found.current_q  # other dividers, the same quotient
    salient = TARGET.read(project(structure=0), "x.stmcx").drive
    assert salient.l_d == pytest.approx(0.0004)
    assert salient.l_q == 0.0008
    sensors = TARGET.read(project(topology=2), "x.stmcx")
    assert (sensors.own["RSHUNT"], sensors.own["AMPLIFICATION_GAIN"]) == (1, 0.05)
    assert found.origins["current_q.kp"].key == "Torque - P dividend"


def test_values_stand_in_a_project_and_all_else_stays() -> None:
    (wish,) = random_asked(1, 37)
    found = ST.configure(wish)
    for structure in (0, 1):
        before = project(structure=structure)
        after = TARGET.write(found, TITLE, before)["drive_st.stmcx"].decode()
        old, new = (ElementTree.fromstring(text) for text in (before, after))
        pairs = list(zip(old.iter(), new.iter(), strict=True))
        changed = {a.get("name") for a, b in pairs if a.attrib != b.attrib}
        assert all(a.tag == b.tag and set(a.attrib) == set(b.attrib) for a, b in pairs)
        assert "Hall sensors" not in changed
        assert ("Ls" in changed) == (structure == 1)
        values = {str(var.get("name")): str(var.get("value")) for var in new.iter("var")}
        assert values["Torque&Flux - Manual editing enabled"] == "true"
        assert float(values["Torque - P dividend"]) == found.own["PID_TORQUE_KP_DEFAULT"]
        back = TARGET.read(after, "x.stmcx")
        assert back.current_q == found.current_q
        assert back.drive.l_q == found.drive.l_q


HOSTILE = {
    "nothing of the MCSDK": ("#define FOO 1\n", "x.h:", "no macro of the MCSDK"),
    "no number": ("#define RSHUNT abc\n", "x.h:1", "RSHUNT is 'abc', not a number"),
    "negative": ("\n#define RSHUNT -1\n", "x.h:2", "RSHUNT is -1; write a value from"),
    "half a pair": ("#define POLE_PAIR_NUM 2.5\n", "x.h:1", "write a whole number"),
    "short table": (
        "#define SEGDIV 10\n#define ANGC {1,2}\n#define OFST {0,0,0,0,0,0,0,0}\n",
        *("x.h:2", "eight whole numbers"),
    ),
    "half a table": ("#define SEGDIV 10\n", "x.h:1", "stands without ANGC"),
    "large slope": (
        "#define SEGDIV 9\n#define ANGC {99999,0,0,0,0,0,0,0}\n#define OFST {0,0,0,0,0,0,0,0}\n",
        *("x.h:2", "beyond 65536"),
    ),
    "open comment": ("#define RSHUNT 1 /* never closed\n", "x.h:1", "not closed"),
    "itself": ("#define RSHUNT RSHUNT\n", "x.h:1", "not a number"),
    "not JSON": ('{"polePairs": 2,', "x.h:", "not JSON"),
    "a word": ('{"polePairs": "two", "BEmfConstant": 1}', "x.h:1", "polePairs is"),
    "no inductance": ('{"polePairs": 2, "BEmfConstant": 1}', "x.h", "ls is missing"),
    "infinite": ('{"polePairs": 2, "ls": 1e999}', "x.h:1", "ls"),
    "an entity": (
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><STWorkBench>&b;</STWorkBench>',
        *("x.h:1", ""),
    ),
    "cut off": ("<STWorkBench><systems>", "x.h:1", ""),
    "no motor": ("<STWorkBench/>", "x.h:1", "has no motor"),
    "no variables": ("<STWorkBench><system/></STWorkBench>", "x.h:1", "has no variables"),
    "a value that is none": (project().replace('value="0.35"', 'value="x"'), "x.h:", "Rs is 'x'"),
    "a rate that is none": (
        project().replace('Execution rate" value="1"', 'Execution rate" value="9"'),
        *("x.h:", "none of its items"),
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_wrong_is_one_line_with_its_place(name: str) -> None:
    text, place, words = HOSTILE[name]
    with pytest.raises(InputError) as caught:
        TARGET.read(text, "x.h")
    assert str(caught.value).startswith(place), str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_files_are_not_recognised() -> None:
    assert not TARGET.recognise("x.h", "#define MCCONF_FOC_CURRENT_KP 1\n")
    assert not TARGET.recognise("x.json", '{"axis0": {}}')
    assert not TARGET.recognise("x.xml", "<MCConfiguration/>")
    assert TARGET.recognise("x.json", '{"polePairs": 2, "BEmfConstant": 1}')
    assert TARGET.recognise("a.stmcx", project())


def test_same_input_same_bytes() -> None:
    (wish,) = random_asked(1, 41)
    assert TARGET.write(ST.configure(wish), TITLE, None) == TARGET.write(
        ST.configure(wish), TITLE, None
    )
    named = replace(base_design(), name='*/ #error "x" /*')
    text = written(replace(ST.configure(wish), name=named.name))["drive_st_parameters.h"]
    assert text.count("*/") == text.count("/*")
