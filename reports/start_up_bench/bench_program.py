"""A program that starts any number of drives with the emitted state machine, and its runs."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer.start_up.start_judgement import StartRecord
from dqforge.reports.operating_system.host_compiler import compile_program, require_compiler
from dqforge.reports.pages.templating import render
from dqforge.reports.simulation.compiled_plant import PLANT_FLAGS
from dqforge.reports.simulation.plant_input import RunInput, share_tables
from dqforge.reports.simulation.plant_layout import PARAMETERS, STATES

# What is recorded at a sampling instant, in this order; ``fault`` is the last one there was.
COLUMNS = (
    *("t", "omega_m", "theta_e", "theta_e_observed", "omega_e_observed"),
    *("theta_e_used", "omega_e_used", "state", "fault", "tries"),
    *("reference", "current", "peak", "broken"),
)

RUN_STATE = 7.0  # Number of the state in which the observer at speed rules.


@dataclass(frozen=True, slots=True)
class BenchProgram:
    """A compiled program; ``shared`` where the current references of the machine are data."""

    program: Path
    shared: bool


@dataclass(frozen=True, slots=True, eq=False)
class StartInput:
    """One start: the plant as the simulation reads it, and the numbers of the controller.

    Args:
        plant: Parameters and tables of the plant, its gains those of the control functions.
        settings, low: Bytes of the structures of the start-up and of the gains of the estimator
            from standstill on; empty for those of the headers.
        torque_per_ampere: In N m/A, where the program's current references are data.
    """

    plant: RunInput
    settings: bytes = b""
    low: bytes = b""
    torque_per_ampere: float = 0.0

    def run(self) -> RunInput:
        """What the program reads."""
        further = (
            _doubles(self.settings),
            _doubles(self.low),
            np.array([self.torque_per_ampere]),
        )
        return RunInput(self.plant.parameters, (*self.plant.tables, *further))


def _doubles(content: bytes) -> FloatArray:
    return np.frombuffer(content + bytes(-len(content) % 8), dtype=np.float64)


def _sources(prefix: str, code: str, low: str, *, shared: bool) -> dict[str, str]:
    context = {
        "prefix": prefix,
        "macro": prefix.upper(),
        "code": code,
        "low": low,
        "shared": shared,
        "parameters": PARAMETERS,
        "states": STATES,
        "columns": COLUMNS,
        "hears": (),
    }
    sources = {
        "plant.c": render("simulation/plant.c.j2", context),
        "phase_plant.c": render("simulation/phase_plant.c.j2", context),
        "main.c": render("start_up_bench/bench_main.c.j2", context),
    }
    if shared:
        sources[f"{prefix}.h"] = render("start_up_bench/any_machine.h.j2", context)
    return sources


@contextmanager
def bench_program(
    files: Mapping[str, bytes], prefix: str, code: str, low: str = "", *, shared: bool
) -> Iterator[BenchProgram]:
    """A compiled program in a folder that goes with the block.

    Args:
        files: Emitted headers by name, that of the start-up among them.
        prefix: That of the headers.
        code: Name in C of the observer at speed.
        low: That of the estimator from standstill on, empty for none.
        shared: Whether the current references are those of any machine without d current, with the
            torque per ampere as data, in place of the design's header.

    Raises:
        VerificationError: There is no compiler, or the headers do not compile.
    """
    compiler = require_compiler()
    with tempfile.TemporaryDirectory(prefix="dqforge-") as name:
        folder = Path(name)
        for file_name, content in files.items():
            (folder / file_name).write_bytes(content)
        for file_name, text in _sources(prefix, code, low, shared=shared).items():
            (folder / file_name).write_text(text, encoding="ascii", newline="\n")
        failed = "the bench of starts does not compile"
        program = compile_program(compiler, PLANT_FLAGS, "main.c", folder, "bench", failed)
        yield BenchProgram(program, shared)


def run_starts(program: BenchProgram, starts: Sequence[StartInput]) -> list[dict[str, FloatArray]]:
    """What was recorded of each start, by the names of `COLUMNS`.

    Args:
        program: The compiled program.
        starts: What it runs.

    Raises:
        VerificationError: The program cannot be run, or the numbers are not those of its headers.
    """
    runs = share_tables([start.run() for start in starts])
    content = np.array([float(len(runs))]).tobytes() + b"".join(run.content() for run in runs)
    done = subprocess.run([str(program.program)], input=content, capture_output=True, check=False)
    if done.returncode != 0:
        raise VerificationError(f"the bench of starts stopped with exit code {done.returncode}")
    numbers, place = np.frombuffer(done.stdout, dtype=np.float64), 0
    found = []
    for _ in runs:
        count = int(numbers[place])
        rows = numbers[place + 1 : place + 1 + count * len(COLUMNS)].reshape(count, len(COLUMNS))
        place += 1 + count * len(COLUMNS)
        found.append({name: rows[:, n].copy() for n, name in enumerate(COLUMNS)})
    return found


def start_record(rows: dict[str, FloatArray]) -> StartRecord:
    """A recorded start as it is judged.

    Args:
        rows: Of `run_starts`.
    """
    gap = rows["theta_e_observed"] - rows["theta_e"]
    return StartRecord(
        time=rows["t"],
        omega_m=rows["omega_m"],
        reference=rows["reference"],
        angle_error=np.asarray((gap + np.pi) % (2.0 * np.pi) - np.pi),
        ruling=(rows["state"] == RUN_STATE).astype(np.float64),
        reported=bool(rows["fault"][-1] != 0.0),
        broken=bool(rows["broken"][-1] != 0.0),
    )
