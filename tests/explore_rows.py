"""Runs artificial rows as the command runs a study: a process that tests can interrupt and kill.

python explore_rows.py OUT '{"count": 100}' '{"workers": 2}'
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from study_rows import StudyRows
from study_runs import run_in

from dqforge.reports.command_line.flags import exit_code
from dqforge.reports.exploration.contained_rows import EngineSettings, TlsFiles


def main() -> int:
    """Run, and end as the command does."""
    folder, rows, settings = sys.argv[1:]
    asked: dict[str, Any] = {key: _frozen(value) for key, value in json.loads(rows).items()}
    found = json.loads(settings)
    found["tls"] = TlsFiles(*found.get("tls", ()))
    if "scheduler_file" in found:
        found["scheduler_file"] = Path(found["scheduler_file"])
    run_in(Path(folder), StudyRows(**asked), EngineSettings(**found))
    return 0


def _frozen(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


if __name__ == "__main__":
    sys.exit(exit_code(main, lambda _: None))
