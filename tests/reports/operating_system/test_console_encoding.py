"""Signs of the field on streams that do not have them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dqforge.machines.design import catalogue

NAME = "Motor ψ µΩ 20 °C ☃"


@pytest.fixture
def design(tmp_path: Path) -> Path:
    text = catalogue.read_text("paper001-pmsm-bench").decode("utf-8")
    lines = [f'name: "{NAME}"' if line.startswith("name:") else line for line in text.splitlines()]
    path = tmp_path / "drive.yaml"
    path.write_text("\n".join(lines), encoding="utf-8", newline="\r\n")
    return path


def dqforge(design: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("LC_")}
    plain.pop("PYTHONIOENCODING", None)
    return subprocess.run(
        [sys.executable, "-m", "dqforge.cli", *words],
        cwd=design.parent,
        env=plain | environment,
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("environment", "encoding", "shown"),
    [
        ({"PYTHONIOENCODING": "cp1252"}, "cp1252", "Motor psi µOhm 20 °C ?"),
        ({"PYTHONIOENCODING": "cp437"}, "cp437", "Motor psi µΩ 20 °C ?"),
        (
            {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"},
            "ascii",
            "Motor psi uOhm 20 degC ?",
        ),
        ({"PYTHONIOENCODING": "ascii:replace"}, "ascii", "Motor ? ?? 20 ?C ?"),
        ({"PYTHONIOENCODING": "utf-8"}, "utf-8", NAME),
    ],
)
def test_what_cannot_be_shown_is_spelled_out(
    environment: dict[str, str], encoding: str, shown: str, design: Path
) -> None:
    done = dqforge(design, "check", design.name, **environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert shown in done.stdout.decode(encoding).splitlines()[0]


def test_messages_are_spelled_out_too(design: Path) -> None:
    words = ("check", design.name, "--set", "machine.resistance=3 Ωψ")
    done = dqforge(design, *words, PYTHONIOENCODING="cp1252")
    assert done.returncode == 2
    assert "'Ohmpsi'" in done.stderr.decode("cp1252")
    assert done.stderr.count(b"\n") == 1
