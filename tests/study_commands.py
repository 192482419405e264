"""`dqforge explore` as somebody starts it: a process that can be interrupted, starved and looked
into, and the studies of a linear drive that it is tried on.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from study_trials import MACHINES, POINTS, loop_names, outputs
from study_workers import parts_in

STRANGE_WORKERS = Path(__file__).resolve().parent / "strange_workers"

_RUN = """
import atexit, json, os, sys, time
from dqforge import cli
def told():
    with open("/proc/self/status") as status:
        lines = [line for line in status if line.startswith("VmHWM:")]
    with open(os.environ["COMMAND_COST"], "w") as file:
        json.dump({"memory": int(lines[0].split()[1]) / 1e3, "seconds": time.process_time()}, file)
atexit.register(told)
cli.main()
"""

_FULL = outputs(
    *(f"reference.{name}" for name in ("torque_max", "i_d", "i_q")),
    *(f"fit.error.{name}" for name in ("i_d", "i_q", "torque", "torque_relative")),
    *loop_names("i_d", "i_q"),
    *(f"gains.{loop}.{name}" for loop in ("i_d", "i_q") for name in ("kp", "ki")),
    *(f"losses.{name}" for name in ("total", "copper", "conduction", "switching")),
    *(f"losses.{name}" for name in ("junction_temperature", "ripple_current")),
    *(f"losses.points.{p}.{name}" for p in range(3) for name in ("total", "junction_temperature")),
    "losses.points.2.copper",
)


def linear_study(count: int) -> str:
    """Drawn machines of a linear drive with all that formulas give: 41 columns beside index, key,
    state and message.
    """
    settings = "  losses.modulations: [ddt-gdpwm]\n  fit.max_torque: 150 N m\n"
    return (
        "dqforge_study: 1\nname: Drawn machines\ndesign: paper000-ipmsm-100kw\n"
        f"{MACHINES}draw: {{count: {count}, seed: 20261122}}\nset:\n{POINTS}{settings}{_FULL}"
    )


@dataclass(frozen=True, slots=True)
class Ended:
    """How a command ended.

    Args:
        memory: Largest memory of its own process in MB, without those of workers; None where it was
            killed.
        seconds: Processor time of its own process in s.
    """

    code: int
    out: str
    err: str
    memory: float
    seconds: float


class Command:
    """`dqforge explore STUDY -o OUT ...`, in a group of processes of its own."""

    def __init__(self, study: Path, out: Path, *words: object, **environment: str) -> None:
        self.out = out
        self._cost = out.with_name(f"{out.name}-cost.json")
        self._cost.unlink(missing_ok=True)
        self.process = subprocess.Popen(
            [sys.executable, "-c", _RUN, "explore", str(study), "-o", str(out), *map(str, words)],
            env={
                **os.environ,
                "OPENBLAS_NUM_THREADS": "1",
                "COMMAND_COST": str(self._cost),
                **environment,
            },
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def parts(self) -> int:
        """How many parts are there."""
        return parts_in(self.out)

    def wait_for_parts(self, count: int) -> None:
        """Wait until so many parts are there."""
        until = time.monotonic() + 300.0
        while self.parts() < count:
            assert time.monotonic() < until
            assert self.process.poll() is None
            time.sleep(0.05)

    def press_ctrl_c(self) -> None:
        """What the key does: all processes of the terminal get the signal."""
        os.killpg(self.process.pid, signal.SIGINT)

    def end(self) -> Ended:
        """Wait for its end."""
        out, err = self.process.communicate(timeout=600.0)
        assert "Traceback" not in err, err
        cost = json.loads(self._cost.read_text()) if self._cost.exists() else {}
        memory, seconds = cost.get("memory", float("nan")), cost.get("seconds", float("nan"))
        return Ended(self.process.returncode, out, err, memory, seconds)


def explored(study: Path, out: Path, *words: object, **environment: str) -> Ended:
    """The command, run to its end."""
    return Command(study, out, *words, **environment).end()


def strange(**asked: object) -> dict[str, str]:
    """The environment of a command whose workers behave as asked: KILLING, HANGING, MEMORY."""
    said = {f"STUDY_{name}": str(value) for name, value in asked.items()}
    return {"PYTHONPATH": str(STRANGE_WORKERS), "STUDY_STRANGE": "1", **said}
