"""Write the parts of a locked installation as a CycloneDX bill of materials, beside the wheel."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def version() -> str:
    """The version that the package tells of itself."""
    text = (ROOT / "__init__.py").read_text(encoding="utf-8")
    found = re.search(r'^__version__ = "([^"]+)"$', text, re.MULTILINE)
    assert found is not None
    return found[1]


def bill() -> str:
    """The bill as JSON, of the locked packages with the hashes of their files; without a date."""
    command = [sys.executable, "-W", "ignore", "-m", "cyclonedx_py", "requirements"]
    command += [str(ROOT / "requirements.lock"), "--pyproject", str(ROOT / "pyproject.toml")]
    command += ["--output-reproducible"]
    made = subprocess.run(command, check=True, capture_output=True, text=True)
    parts = json.loads(made.stdout)
    # The project file names no version: the package does.
    parts["metadata"]["component"] |= {
        "version": version(),
        "purl": f"pkg:pypi/dqforge@{version()}",
    }
    return f"{json.dumps(parts, indent=1, sort_keys=True)}\n"


if __name__ == "__main__":
    (ROOT / "dist").mkdir(exist_ok=True)
    path = ROOT / "dist" / f"dqforge-{version()}.cdx.json"
    path.write_text(bill(), encoding="utf-8", newline="\n")
    sys.stdout.write(f"{path.relative_to(ROOT)}\n")
