"""What a shell offers while a command is typed, asked as the shells ask for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dqforge.machines.design import catalogue as drives
from dqforge.machines.exploration import study_checks as shipped_studies
from dqforge.reports.command_line.flags import designs, studies

COMMAND = Path(sys.executable).with_name("dqforge")
# Words typed so far, in the form in which each shell hands them on.
ASKED = {
    "bash": lambda line: {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))},
    "zsh": lambda line: {"_TYPER_COMPLETE_ARGS": line},
    "fish": lambda line: {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    "powershell": lambda line: {
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_WORD_TO_COMPLETE": line.rpartition(" ")[2],
    },
}


def offered(shell: str, line: str) -> str:
    environment = os.environ | ASKED[shell](line) | {"_DQFORGE_COMPLETE": f"complete_{shell}"}
    done = subprocess.run(
        [COMMAND], env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.stderr == ""
    return done.stdout


@pytest.mark.parametrize("shell", ASKED)
def test_each_shell_gets_drives_commands_and_options(shell: str) -> None:
    assert "paper000-ipmsm-100kw" in offered(shell, "dqforge tune paper0")
    assert "abb-" not in offered(shell, "dqforge tune paper0")
    assert "hoverboard-hub" in offered(shell, "dqforge run hover")
    assert "estimators" in offered(shell, "dqforge es")
    assert "--speed" in offered(shell, "dqforge mtpa paper000-ipmsm-100kw --sp")


def test_bash_completes_by_the_script_that_is_installed(tmp_path: Path) -> None:
    """The script of ``--install-completion``, in a shell of its own."""
    script = subprocess.run(
        [COMMAND],
        env=os.environ | {"_DQFORGE_COMPLETE": "source_bash"},
        capture_output=True,
        text=True,
        check=False,
    ).stdout
    asked = (
        "COMP_WORDS=(dqforge check my); COMP_CWORD=2; _dqforge_completion dqforge; "
        'echo "${COMPREPLY[@]}"'
    )
    (tmp_path / "mydrive").mkdir()
    path = f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", f"{script}\n{asked}"],
        cwd=tmp_path,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "mydrive/\n"


def test_designs_are_drives_files_and_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one", "one/deeper", ".hidden"):
        (tmp_path / name).mkdir()
    for name in ("a.yaml", "b.YML", "c.txt", ".d.yaml", "one/x.yaml", "one/strange name.yaml"):
        (tmp_path / name).touch()
    assert designs("") == [*drives.names(), *drives.motors(), "one/", "a.yaml", "b.YML"]
    assert designs("one/") == ["one/deeper/", "one/strange name.yaml", "one/x.yaml"]
    assert designs("./a") == ["./a.yaml"]
    assert designs("nowhere/at/all") == []
    assert studies("") == [*shipped_studies.names(), "one/", "a.yaml", "b.YML"]
