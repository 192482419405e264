"""Peak memory of a program in a process of its own."""

from __future__ import annotations

import subprocess
import sys

# The kernel's own high-water mark of the process that runs the program. getrusage would carry on
# the mark of the process that started it, which may be larger than anything measured here.
_TELL = """
with open("/proc/self/status") as _status:
    print(next(line for line in _status if line.startswith("VmHWM")).split()[1])
"""


def run_and_measure(program: str, *arguments: str) -> tuple[str, int]:
    """What `program` printed and the largest memory it held, in bytes."""
    done = subprocess.run(
        [sys.executable, "-c", program + _TELL, *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    *printed, peak = done.stdout.strip().split("\n")
    return "\n".join(printed), 1024 * int(peak)
