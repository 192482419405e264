"""Table 3 of paper 000 on emulated cores."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.reports.papers import paper000_load_test as core_costs
from dqforge.reports.papers import paper000_whole_paper as method_tables
from dqforge.reports.papers.paper000_load_test import CORES, PRINTED_MICROSECONDS, CoreCosts
from dqforge.reports.papers.paper000_stated_method import PRINTED_TABLE_2

_HEADERS = {
    "only.h": (
        b"static inline void only_current_reference(float t, float *i_d, float *i_q)\n"
        b"{\n    *i_d = 0.0F;\n    *i_q = t;\n}\n"
    ),
    "fixed.h": (
        b"static inline void fixed_current_reference_q15(int16_t t, int16_t *i_d, int16_t *i_q)\n"
        b"{\n    *i_d = 0;\n    *i_q = t;\n}\n"
    ),
}

MACHINE = linearised(catalogue.load("paper000-ipmsm-100kw").machine)

needs_target = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="needs the Debian packages gcc-arm-none-eabi and qemu-system-arm",
)


def test_all_ways_give_the_currents_that_they_should(tmp_path: Path) -> None:
    """Compiled for the host: polynomials by Horner and by powers alike, Morimoto by (15)."""
    for name, content in core_costs.method_sources(MACHINE, _HEADERS, "only", "fixed").items():
        (tmp_path / name).write_bytes(content)
    names = [
        "direct",
        "morimoto_double",
        "morimoto_single",
        *(f"{kind}_4" for kind in ("horner", "powers_double", "powers_single")),
    ]
    calls = "".join(
        f'{name}(t, &d, &q); printf("%.9g %.9g\\n", (double)d, (double)q);' for name in names
    )
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "methods.c"\n'
        f"int main(void) {{ float d, q; const float t = 90.0F; {calls} return 0; }}\n"
    )
    flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Wdouble-promotion", "-Werror"]
    subprocess.run(["cc", *flags, "main.c", "-o", "all", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([str(tmp_path / "all")], capture_output=True, text=True, check=True)
    found = {
        name: tuple(float(value) for value in line.split())
        for name, line in zip(names, done.stdout.splitlines(), strict=True)
    }
    assert found["direct"] == pytest.approx((0.0, 90.0 / (6.0 * 0.1049)), rel=1e-6)
    base = 0.1049 / (2.0 * 242e-6)
    for name in ("morimoto_double", "morimoto_single"):
        assert found[name] == pytest.approx((base - np.hypot(base, 90.0), 90.0), abs=2e-4)
    expected = tuple(np.polyval(PRINTED_TABLE_2[axis, 4][0], 90.0) for axis in "dq")
    for kind in ("horner", "powers_double", "powers_single"):
        assert found[f"{kind}_4"] == pytest.approx(expected, abs=1e-4)


@pytest.fixture(scope="module")
def found() -> CoreCosts:
    return core_costs.core_costs(MACHINE, _HEADERS, "only", "fixed")


@needs_target
@pytest.mark.slow
def test_the_printed_times_are_those_of_a_build_without_optimisation(found: CoreCosts) -> None:
    assert found.left_out == {}
    for method, printed in PRINTED_MICROSECONDS.items():
        low, high = found.microseconds(method, "plain")
        assert low < printed < 1.3 * high, method
    # the printed savings against Morimoto, 95.53 % and 93.56 %, follow
    morimoto = found.microseconds("morimoto", "plain")[1]
    for degree, saved in ((2, 0.9553), (4, 0.9356)):
        share = 1.0 - found.microseconds(f"horner_{degree}", "plain")[1] / morimoto
        assert share == pytest.approx(saved, abs=0.01)
    # and vanish with a root in single precision
    single = found.microseconds("morimoto", "single")[1]
    assert all(single < found.microseconds(f"horner_{n}", "single")[0] for n in (2, 3, 4))


@needs_target
@pytest.mark.slow
def test_every_core_has_every_method(found: CoreCosts) -> None:
    assert {row.core for row in found.rows} == set(CORES)
    assert len(found.rows) == len(CORES) * 10
    costs = {(row.core, row.method): row for row in found.rows}
    for row in found.rows:
        if row.plain is not None and row.optimised is not None and row.single is not None:
            assert row.plain.instructions > row.optimised.instructions
            assert row.single.instructions <= row.optimised.instructions
    soft, hard = (costs[core, "horner_4"].single for core in ("cortex-m0plus", "cortex-m4"))
    assert soft is not None
    assert hard is not None
    assert soft.instructions > 20.0 * hard.instructions
    table = method_tables.cost_table(found)
    assert len(table.rows) == len(found.rows)
    assert any("explain them" in note for note in table.notes)


def test_without_tools_the_lines_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    found = core_costs.core_costs(MACHINE, _HEADERS, "only", "fixed")
    assert found.rows == ()
    assert set(found.left_out) == set(CORES)
    table = method_tables.cost_table(found)
    assert all("Debian package" in row[1] for row in table.rows)
