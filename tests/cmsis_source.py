"""CMSIS-DSP 1.10.3 as PyPI has it, fetched into a folder outside the repository."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
import tarfile
from pathlib import Path

from control_chain import Step

VERSION = "1.10.3"

SHA256 = "307d32298faa7c58db912851027fce35f886fec7eb1a27c4b309ce1a97f47519"

NEEDED = ("Include/", "PrivateInclude/", "Source/ControllerFunctions/", "LICENSE")

# The file as part of a system's header: its warnings are not ours to mend.
SINE = b"#include <arm_sin_cos_f32.c>\n"

PREPARE = """measured.i.a = r[0]; measured.i.b = r[1]; measured.i.c = r[2]; measured.theta_e = r[3];
        measured.omega_m = r[4]; measured.v_dc = r[5]; reference.d = r[6]; reference.q = r[7];
        control.d.state[2] = r[8]; control.q.state[2] = r[9];"""

# A0 = kp + ki t_s and A1 = -kp of the incremental form; no derivative.
START = """control.d.A0 = DRIVE_CONTROL_GAINS.d.kp + DRIVE_CONTROL_GAINS.d.ki_ts;
    control.d.A1 = -DRIVE_CONTROL_GAINS.d.kp;
    control.q.A0 = DRIVE_CONTROL_GAINS.q.kp + DRIVE_CONTROL_GAINS.q.ki_ts;
    control.q.A1 = -DRIVE_CONTROL_GAINS.q.kp;
    control.pole_pairs = DRIVE_CONTROL_GAINS.pole_pairs;
    control.l_d_H = DRIVE_CONTROL_GAINS.l_d_H;
    control.l_q_H = DRIVE_CONTROL_GAINS.l_q_H;
    control.psi_pm_Wb = DRIVE_CONTROL_GAINS.psi_pm_Wb;
    control.voltage_share = DRIVE_CONTROL_GAINS.voltage_share;
    control.advance_s = DRIVE_CONTROL_GAINS.advance_s;"""


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "dqforge-benchmarks"


def _archive(folder: Path) -> Path | None:
    """The source distribution in the folder, downloaded where it is missing."""
    path = folder / f"cmsisdsp-{VERSION}.tar.gz"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        command = [
            sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check",
            "--no-deps", "--no-build-isolation", "--no-binary", ":all:", "-d", str(folder),
            f"cmsisdsp=={VERSION}",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, check=False)
        if done.returncode != 0 or not path.is_file():
            return None
    return path


def cmsis_folder() -> Path | None:
    """Folder of the unpacked source, None where it cannot be had.

    Raises:
        ValueError: What was downloaded is not the distribution that is known.
    """
    folder = _cache()
    path = _archive(folder)
    if path is None:
        return None
    if hashlib.sha256(path.read_bytes()).hexdigest() != SHA256:
        raise ValueError(f"{path} is not cmsisdsp {VERSION}; remove it")
    source = folder / f"cmsisdsp-{VERSION}"
    if not (source / "LICENSE").is_file():
        with tarfile.open(path) as archive:
            members = [
                member
                for member in archive.getmembers()
                if member.name.partition("/")[2].startswith(NEEDED)
            ]
            archive.extractall(folder, members=members, filter="data")
    return source


def _sine_table() -> bytes:
    """The table that CMSIS-DSP's sine reads, 512 steps of a turn, computed here."""
    values = ", ".join(f"{math.sin(2.0 * math.pi * n / 512):.9f}F" for n in range(513))
    return (
        "#include <arm_common_tables.h>\n\n"
        f"const float32_t sinTable_f32[FAST_MATH_TABLE_SIZE + 1] = {{ {values} }};\n"
    ).encode("ascii")


def cmsis_step(ours: Step, source: Path) -> Step:
    """The current control made of CMSIS-DSP, on the rows and with the gains of ours."""
    here = Path(__file__).resolve().parent / "firmware" / "cmsis_step.h"
    files = dict(ours.files) | {
        "cmsis_step.h": here.read_bytes(), "cmsis_sine.c": SINE, "cmsis_table.c": _sine_table(),
    }  # fmt: skip
    folders = ("Include", "PrivateInclude", "Source/ControllerFunctions")
    flags = tuple(part for name in folders for part in ("-isystem", str(source / name)))
    return Step(
        "the same of CMSIS-DSP 1.10.3", "float32", files, "cmsis_step.h",
        "cmsis_control_t *control, const drive_measured_t *measured, drive_dq_t reference",
        "return cmsis_current_control(control, measured, reference);",
        "&control, &measured, reference", ours.rows, "drive_abc_t",
        "static cmsis_control_t control; static drive_measured_t measured; drive_dq_t reference;",
        START, PREPARE, (*flags, "-D__GNUC_PYTHON__"),
    )  # fmt: skip
