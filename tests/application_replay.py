"""The emitted program with a replay in place of its hardware: rows of samples in, outputs out."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files

OFFSETS, READY, ALIGN, RUN, STOP, FAULT = range(6)

(
    NO_FAULT,
    SAMPLE,
    OFFSET,
    TRIP,
    OVERCURRENT,
    UNDERVOLTAGE,
    OVERVOLTAGE,
    ENCODER_STILL,
    ENCODER_WRONG,
    START,
) = range(10)

_LOOP = "control.speed_loop={method: symmetrical-optimum, ratio: 10}"

KINDS = {
    "start-up": (
        "control.observer={method: flux}",
        "control.start_up={method: i-f, load_torque: 0.1 N m, hand_over: 900 rpm}",
        _LOOP,
    ),
    "edges": (_LOOP.replace("}", ", measurement: {method: mixed, lines: 1024, clock: 10 MHz}}"),),
    "counts": (_LOOP.replace("}", ", measurement: {method: counts, lines: 1024}}"),),
    # with the gains of the bench: dead time acts on the observer as a relay, which quick ones hear
    # with the gains of the bench: its dead time is a relay in the observer, which quick gains hear
    "observer": ("control.observer={pole: 900 rad/s}",),
}

# Designs whose program lacks something: format, and settings.
INCOMPLETE = {"nothing": ("float32", (_LOOP,)), "integers": ("q15", KINDS["counts"])}

_CURRENT_LOOP = "control.current_loop={method: magnitude-optimum}"

_COMMON = (
    "export.application=skeleton",
    "export.prefix=drive",
)


def design(kind: str, *settings: str) -> Design:
    """The bench of paper 001 with the program around its functions."""
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    text = re.sub(r"  observer:\n    pole:[^\n]*\n", "", text)
    number_format, own = INCOMPLETE.get(kind, ("float32", KINDS.get(kind, ())))
    loop = () if kind == "observer" else (_CURRENT_LOOP,)
    emitted = f"export.control={number_format}"
    return load_text(
        text.encode(), "bench.yaml", settings=[*own, *loop, emitted, *_COMMON, *settings]
    )


# i_a, i_b, i_c, v_dc, reference as bits of float32; run, trip, position, time of the timer.
ROW = 9
OUT = 6  # Bits of three duty cycles, gate pulses, state, fault.

REPLAY = """#include <stdint.h>
#include <string.h>
{head}
static uint32_t row[{row}];
static uint32_t out[{out}];
static int32_t next_row(void);
static int32_t keep(void);
#define main application_main
#include "drive_main.c"
#undef main

void drive_hardware_init(void) {{}}
void drive_hardware_start(void) {{}}
void drive_hardware_read(drive_hardware_sample_t *sample)
{{
    memcpy(&sample->i_a, &row[0], 4U);
    memcpy(&sample->i_b, &row[1], 4U);
    memcpy(&sample->i_c, &row[2], 4U);
    memcpy(&sample->v_dc, &row[3], 4U);
    memcpy(&sample->reference, &row[4], 4U);
    sample->run = row[5];
    sample->trip = row[6];
{more}}}
void drive_hardware_write(const drive_hardware_output_t *output)
{{
    memcpy(&out[0], &output->duty_a, 4U);
    memcpy(&out[1], &output->duty_b, 4U);
    memcpy(&out[2], &output->duty_c, 4U);
    out[3] = output->gate;
}}
void drive_hardware_status(uint32_t state, uint32_t fault, uint32_t start_fault, float omega_m)
{{
    (void)start_fault;
    (void)omega_m;
    out[4] = state;
    out[5] = fault;
}}
uint32_t drive_hardware_wait(void)
{{
    static uint32_t begun = 0U;

    if ((begun != 0U) && (keep() != 0)) {{
        return 0U;
    }}
    begun = 1U;
    if (next_row() != 0) {{
        return 0U;
    }}
    drive_current_sample_interrupt();
    return 1U;
}}
{tail}
"""

_POSITION = "    sample->position = row[7];\n"

_EDGES = """    sample->now = row[8];
"""

_EDGE = """void drive_hardware_edge(uint32_t *stamp, int32_t *sense)
{
    *stamp = row[8];
    *sense = 1;
}
"""

_HOST = """static int32_t next_row(void)
{
    return (fread(row, sizeof row, 1U, stdin) == 1U) ? 0 : 1;
}
static int32_t keep(void)
{
    return (fwrite(out, sizeof out, 1U, stdout) == 1U) ? 0 : 1;
}
int main(void)
{
    return application_main();
}
"""

_TARGET = """static const uint32_t rows[COUNT][ROW_SIZE] = {{ROWS}};
static const uint32_t wanted[COUNT][OUT_SIZE] = {{WANTED}};
static uint32_t at = 0U;
static uint32_t failed = 0U;
static int32_t next_row(void)
{
    if (at >= COUNT) {
        return 1;
    }
    memcpy(row, rows[at], sizeof row);
    return 0;
}
static int32_t keep(void)
{
    failed += (memcmp(out, wanted[at], sizeof out) != 0) ? 1U : 0U;
    at += 1U;
    return 0;
}
int main(void)
{
    (void)application_main();
    return ((failed == 0U) && (at == COUNT)) ? 0 : 101;
}
"""


def _source(kind: str, head: str, tail: str) -> str:
    more = "" if kind == "start-up" else _POSITION + (_EDGES if kind == "edges" else "")
    edge = _EDGE if kind == "edges" else ""
    return REPLAY.format(head=head, row=ROW, out=OUT, more=more, tail=edge + tail)


def target_source(kind: str, rows: NDArray[np.uint32], wanted: NDArray[np.uint32]) -> str:
    """The program for an emulated core: rows and the outputs of the host are constants."""

    def text(values: NDArray[np.uint32]) -> str:
        return ",\n".join("{" + ",".join(f"{v}U" for v in row) + "}" for row in values.tolist())

    sizes = f"#define COUNT {len(rows)}U\n#define ROW_SIZE {ROW}\n#define OUT_SIZE {OUT}\n"
    tail = _TARGET.replace("{ROWS}", text(rows)).replace("{WANTED}", text(wanted))
    return _source(kind, sizes, tail)


@dataclass(frozen=True)
class HostProgram:
    """The program compiled for the host, with what was emitted."""

    kind: str
    design: Design
    files: dict[str, bytes]
    path: Path

    def run(self, rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Outputs after every row, shape (N, 6)."""
        done = subprocess.run([self.path], input=rows.tobytes(), capture_output=True, check=True)
        return np.frombuffer(done.stdout, dtype=np.uint32).reshape(-1, OUT)


def _short(content: bytes) -> bytes:
    """The program with offsets of 40 samples and an alignment of 60, for a core's flash."""
    text = re.sub(r"\d+U(,? /\* offset_samples)", r"40U\1", content.decode())
    return re.sub(r"\d+U(,? /\* align_samples)", r"60U\1", text).encode()


def host_program(kind: str, folder: Path, *, short: bool = False) -> HostProgram:
    """Emit and compile."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    made = design(kind)
    files = emitted_files(solve(made))
    if short:
        files |= {"drive_application.h": _short(files["drive_application.h"])}
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "replay.c").write_text(_source(kind, "#include <stdio.h>\n", _HOST))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    subprocess.run([compiler, *flags, "replay.c", "-o", "replay", "-lm"], cwd=folder, check=True)
    return HostProgram(kind, made, files, folder / "replay")


def samples(count: int, **changes: float) -> NDArray[np.uint32]:
    """Rows of a drive at rest with its command given: no current, its dc link, 1500 rpm."""
    floats = np.zeros((count, 5), dtype=np.float32)
    floats[:, 3], floats[:, 4] = 214.0, 157.0
    rows = np.zeros((count, ROW), dtype=np.uint32)
    rows[:, 5] = 1
    rows[:, 8] = (np.arange(count) * 2000) % 65536
    for key, value in changes.items():
        place = ("i_a", "i_b", "i_c", "v_dc", "reference", "run", "trip", "position").index(key)
        if place < 5:
            floats[:, place] = value
        else:
            rows[:, place] = int(value)
    rows[:, :5] = floats.view(np.uint32)
    return rows
