"""The same last digits on every processor of a kind: OpenBLAS and numpy are given one set of
instructions, whatever the environment says.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    platform.machine().lower() not in {"x86_64", "amd64"}, reason="kernels of x86"
)

CORES = ("Sandybridge", "Haswell", "Prescott")
SUMS = """
{before}
import numpy as np
from scipy.linalg import expm
a = np.random.default_rng(1).normal(size=(23, 23))
found = [a @ a, np.linalg.eigvals(a), np.linalg.inv(a), expm(a), np.exp(a), np.sin(1e3 * a)]
print("".join(each.tobytes().hex() for each in found))
"""
PREPARED = "from dqforge.reports.operating_system.system import prepare_process; prepare_process()"


def printed(core: str, before: str) -> str:
    own = {key: value for key, value in os.environ.items() if key != "NPY_DISABLE_CPU_FEATURES"}
    done = subprocess.run(
        [sys.executable, "-c", SUMS.format(before=before)],
        env=own | {"OPENBLAS_CORETYPE": core, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def test_a_process_of_dqforge_sums_in_one_order() -> None:
    """Without it the digits move, so that this test can fail."""
    assert len({printed(core, "") for core in CORES}) > 1
    assert len({printed(core, PREPARED) for core in CORES}) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "drive",
    ["thor-pmsyrm-5k", "baldor-pmsyrm-5k6", "salient-phase-waveforms", "vdyno-trampa-6340"],
)
def test_a_run_has_the_same_bytes_with_every_kernel(drive: str, tmp_path: Path) -> None:
    """These four moved, each in another place."""
    digests = set()
    for core in CORES:
        words = ["run", drive, "-o", str(tmp_path / core), "--no-verify"]
        subprocess.run(
            [sys.executable, "-m", "dqforge.cli", *words],
            env=os.environ | {"OPENBLAS_CORETYPE": core},
            capture_output=True,
            check=True,
        )
        files = sorted((tmp_path / core).rglob("*"))
        content = b"".join(path.read_bytes() for path in files if path.is_file())
        digests.add(hashlib.sha256(content).hexdigest())
    assert len(digests) == 1
