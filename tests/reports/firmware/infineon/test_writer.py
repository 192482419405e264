"""Parameters of motor-ctrl-lib written: compiled against a structure of our own, read back, put
into a file that assigns them already.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from firmware_asked import random_asked, scooter
from firmware_round_trips import kept_of, output_of

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.infineon_format import KEYS, TABLE, TABLE_KEYS
from dqforge.optimizer.firmware.targets.infineon import configure
from dqforge.reports.firmware.infineon import TARGET, read, write
from dqforge.reports.firmware.target import FileTitle

TITLE = FileTitle("scooter", "hub */ of a scooter", "ab" * 32, "0.1", ("one */ #error remark",))
NAME = "scooter_params.h"


def text_of(found: Configuration, existing: str | None = None) -> str:
    return write(found, TITLE, existing)[NAME].decode()


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_random_machines_come_back(count: int) -> None:
    for asked in random_asked(count):
        found = configure(asked)
        assert kept_of(read(text_of(found), NAME)) == kept_of(found)


def test_same_input_same_bytes_without_dates() -> None:
    first = text_of(configure(scooter()))
    assert first == text_of(configure(scooter()))
    assert not re.search(r"\b20\d\d-\d\d|\r", first)


def plain(text: str) -> dict[str, str]:
    """Members and their texts, by a reader of its own."""
    found = re.findall(r"^ +params->([\w.]+) = ([^;]+); /\* .* \*/$", text, re.MULTILINE)
    return dict(found)


def test_the_scooters_parameters() -> None:
    values = plain(text_of(configure(scooter())))
    assert values["motor.P"] == "30.0f"
    assert values["motor.lam"] == "0.006125877f"
    assert values["motor.i_peak"] == "56.56854f"
    assert values["sys.samp.fpwm_fs0_ratio"] == "1U"
    assert values["sys.analog.filt.w0_i_ph"] == "20000.0f"
    assert values["ctrl.curr.kp.q"] == "0.6283185f"
    assert values["filt.spd_ar_en"] == "Dis"
    for text in values.values():
        assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]\d\d)?f|\d+U|Dis", text), text


def structure() -> str:
    """A structure with the members that are assigned, and no others; of our own."""
    tree: dict[str, object] = {}
    for name in (*KEYS, *TABLE_KEYS):
        *path, leaf = name.split(".")[1:]
        node = tree
        for part in path:
            child = node.setdefault(part, {})
            assert isinstance(child, dict)
            node = child
        kind = "unsigned int" if name.endswith("_ratio") else "float"
        node[leaf] = "enum switched" if leaf == "spd_ar_en" else kind
    lut = tree["motor"]
    assert isinstance(lut, dict)
    lut["mtpa_lut"]["y[LUT_1D_WIDTH]"] = "float"

    def members(node: dict[str, object]) -> Iterator[str]:
        for name, kind in node.items():
            if isinstance(kind, dict):
                yield f"struct {{ {' '.join(members(kind))} }} {name};"
            else:
                yield f"{kind} {name};"

    return (
        "enum switched { Dis = 0, En = 1 };\ntypedef struct { "
        + " ".join(members(tree))
        + " } PARAMS_t;\n"
    )


@pytest.mark.parametrize("build", ["CTRL_METHOD_RFO", "CTRL_METHOD_SFO", "CTRL_METHOD_TBC"])
def test_the_headers_are_c(build: str, tmp_path: Path) -> None:
    lines = ["#include <stdio.h>", f"#define {build}", "#define LUT_1D_WIDTH (1 << 7)", structure()]
    body, expected = [], []
    for index, asked in enumerate(random_asked(6)):
        found = configure(asked)
        header = write(found, FileTitle(f"m{index}", "x", "0", "0"), None)
        (tmp_path / f"m{index}.h").write_bytes(header[f"m{index}_params.h"])
        lines.append(f'#include "m{index}.h"\nstatic PARAMS_t p{index};')
        body.append(f"    m{index}_set_params(&p{index});\n    m{index}_set_gains(&p{index});")
        for name, value in found.own.items():
            rotor = name in KEYS and KEYS[name].place != "any"
            stator = name in TABLE_KEYS
            if (rotor and build != "CTRL_METHOD_RFO") or (stator and build != "CTRL_METHOD_SFO"):
                continue
            if name == TABLE:
                points = [float(part) for part in str(value).split(",")]
                chosen = range(0, 128, 9) if build == "CTRL_METHOD_SFO" else ()
                for place in chosen:
                    member = f"p{index}.motor.mtpa_lut.y[{place}]"
                    body.append(f'    printf("%.9g\\n", (double){member});')
                    expected.append(points[place])
                continue
            member = name.replace("params", f"p{index}", 1)
            body.append(f'    printf("%.9g\\n", (double){member});')
            expected.append(0.0 if isinstance(value, str) else float(value))
    lines += ["int main(void)\n{", *body, "    return 0;\n}"]
    (tmp_path / "main.c").write_text("\n".join(lines) + "\n")
    output = output_of(tmp_path, "main.c")
    assert [float(line) for line in output.split()] == pytest.approx(expected, rel=1e-7)


# Laid out as the library's own file, with values and words of our own.
DEFAULTS = """#include "Controller.h"
#if !defined(OURS)
PARAMS_t params;
#endif
void manual(void)
{
    params.motor.P = 8.0f; // poles
    params.motor.lq = 200.0E-6f; // henry
    params.motor.ld = 150.0E-6f; // henry
    params.motor.lam = 12.0E-3f; // measured
    params.motor.r = 90.0E-3f;
    params.motor.i_peak = 30.0f;
    params.motor.w_max.elec = MECH_TO_ELEC(HZ_TO_RADSEC(RPM_TO_HZ(4000.0f)), params.motor.P); // max
    params.motor.i2t.therm_tau = 5.0f; // s
    params.sys.samp.fpwm_fs0_ratio = 2U;
    params.sys.samp.fs0 = 15.0E3;
    params.sys.vdc_nom = 36.0f;
#if defined(SOME_TEST)
    params.obs.pll.w0 = HZ_TO_RADSEC(1.5E3f); // rad/s
#endif
    params.mech.inertia = 0.5f * POW_TWO(0.05f);
    params.ctrl.speed.bw = HZ_TO_RADSEC(8.0f); // rad/s
#if defined(CTRL_METHOD_RFO) || defined(CTRL_METHOD_TBC)
    params.ctrl.curr.bw = HZ_TO_RADSEC(1.0E3f); // rad/s
#endif
}
void automatic(void)
{
#if defined(CTRL_METHOD_RFO)
    params.ctrl.curr.kp.q = params.motor.lq * params.ctrl.curr.bw; // V/A
    params.ctrl.curr.ki.q = params.motor.r * params.ctrl.curr.bw;
#elif defined(CTRL_METHOD_TBC)
    params.ctrl.curr.kp = params.motor.lq * params.ctrl.curr.bw;
#endif
}
"""


def test_what_a_file_assigns_is_replaced_and_all_else_stays() -> None:
    found = configure(scooter())
    lines = text_of(found, DEFAULTS).splitlines()
    for kept in (
        '#include "Controller.h"',
        "    params.motor.P = 30.0f; // poles",
        "    params.motor.lam = 0.006125877f; // measured",
        "    params.motor.w_max.elec = 3750.0f; // max",
        "    params.motor.i2t.therm_tau = 5.0f; // s",
        "    params.obs.pll.w0 = HZ_TO_RADSEC(1.5E3f); // rad/s",
        "    params.ctrl.curr.kp.q = 0.6283185f; // V/A",
        "    params.ctrl.curr.kp = params.motor.lq * params.ctrl.curr.bw;",
    ):
        assert kept in lines, kept
    assert len(lines) == len(DEFAULTS.splitlines())
    back = read("\n".join(lines), "ParamsDefault.c")
    assert back.drive == found.drive or back.drive.viscous is None
    assert back.current_q == found.current_q


def test_a_header_as_written_before_is_taken_over_anew() -> None:
    first, second = (configure(one) for one in random_asked(2))
    assert read(text_of(second, text_of(first)), NAME).drive == second.drive


def test_damaged_files_are_not_written_into() -> None:
    with pytest.raises(InputError):
        write(configure(scooter()), TITLE, DEFAULTS.replace("#endif\n}", "}"))


def test_the_target_is_whole() -> None:
    assert TARGET.method.name == "infineon"
    written = TARGET.write(configure(scooter()), TITLE, None)
    assert all(TARGET.recognise(name, content.decode()) for name, content in written.items())
