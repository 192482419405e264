"""What `dqforge doctor` says of this machine, and of one that has nothing."""

from __future__ import annotations

import json
import shutil
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from hidden_compilers import hide_compilers

from dqforge.reports.answers.doctor import answer_doctor
from dqforge.reports.operating_system import host_compiler, packages, system
from dqforge.reports.operating_system import packages as this_machine
from dqforge.reports.operating_system.packages import PACKAGES, PROGRAMS, WAYS, look, try_compiler


def test_what_is_here_is_found_and_tried() -> None:
    machine = look()
    assert [trial.failure for trial in machine.trials] == ["", ""]
    assert machine.broken == ()
    answer = answer_doctor()
    assert answer.exit_code == 0
    assert answer.plain["ready"] is True
    packages = {entry["name"]: entry for entry in answer.plain["packages"]}
    assert packages["numpy"]["version"] == metadata.version("numpy")
    assert packages["numpy"]["needed"]
    assert not packages["h5py"]["needed"]
    json.dumps(answer.plain)
    for program in machine.programs:
        assert bool(program.path) == (shutil.which(program.name) is not None)


def test_every_package_that_dqforge_names_is_explained() -> None:
    named = {package.name for package in look().packages}
    assert named == set(PACKAGES)
    assert all(package.use for package in look().packages)


def test_a_machine_without_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    hide_compilers(monkeypatch)
    monkeypatch.setattr(metadata, "version", _only_numpy)
    answer = answer_doctor()
    assert answer.exit_code == 1
    assert answer.notes[0].startswith("no C compiler found: python -m pip install 'dqforge[cc]'")
    assert "scipy is missing: python -m pip install scipy" in answer.notes
    assert not any(note.startswith(("numpy", "h5py")) for note in answer.notes)
    assert answer.plain["ready"] is False
    assert all(entry["path"] is None for entry in answer.plain["programs"])
    (_, programs, _) = answer.tables
    assert all(row[1] == "no" and row[2] and row[3] for row in programs.rows)


def _only_numpy(name: str) -> str:
    if name == "numpy":
        return "2.0"
    raise metadata.PackageNotFoundError(name)


@pytest.mark.parametrize(
    ("script", "phrase"),
    [
        ("echo 'trial.c:1:1: error: no' >&2; exit 1", "cc: trial.c:1:1: error: no"),
        ("exit 0", "its program cannot be started"),
        ("while [ $1 != -o ]; do shift; done; cp /bin/cat $2", "other results than numpy"),
    ],
)
def test_a_compiler_that_does_not_work_is_said_to(
    script: str, phrase: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text(f"#!/bin/sh\n{script}\n", encoding="ascii")
    compiler.chmod(0o755)
    monkeypatch.setenv("DQFORGE_CC", str(compiler))
    tried = try_compiler("c")
    assert phrase in tried.failure
    assert tried.path == str(compiler)
    assert answer_doctor().exit_code == 1


def test_contraction_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The trial's program with a fused multiply-add, by hand."""
    compiled = host_compiler.compile_program
    with_fma = ("#include <stdio.h>", "#include <stdio.h>\n#include <math.h>")

    def fused(*words: object) -> Path:
        _, _, name, folder, *_ = words
        assert isinstance(folder, Path)
        source = folder / str(name)
        text = source.read_text(encoding="ascii").replace(*with_fma)
        changed = text.replace("in[0] * in[1] + in[2]", "fmaf(in[0], in[1], in[2])")
        assert changed != text
        source.write_text(changed, encoding="ascii")
        return compiled(*words)  # type: ignore[arg-type]

    monkeypatch.setattr("dqforge.reports.operating_system.packages.compile_program", fused)
    assert "other results than numpy" in try_compiler("c").failure


@pytest.mark.parametrize(
    ("windows", "macos", "there", "said"),
    [
        (True, False, "", "winget install Cppcheck.Cppcheck"),
        (False, True, "", "brew install cppcheck"),
        (False, False, "apt-get", "sudo apt-get install cppcheck"),
        (False, False, "dnf", "sudo dnf install cppcheck"),
        (False, False, "", "install cppcheck"),
    ],
)
def test_ways_of_each_system(
    windows: bool, macos: bool, there: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(system, "WINDOWS", windows)
    monkeypatch.setattr(system, "MACOS", macos)
    monkeypatch.setattr(shutil, "which", lambda name: name if name == there else None)
    assert WAYS["cppcheck"].here() == said
    assert WAYS["c"].here().startswith("python -m pip install 'dqforge[cc]'")


def test_there_is_a_way_to_every_program_and_the_extra_exists() -> None:
    assert set(PROGRAMS) | set(this_machine.COMPILERS) <= set(WAYS)
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8"))
    extras = project["project"]["optional-dependencies"]
    assert extras["cc"][0].startswith("ziglang")
    assert set(packages.EXTRAS) <= set(extras)
    for extra in packages.EXTRAS:
        names = {line.split(">")[0] for line in extras[extra]}
        assert names <= set(PACKAGES)


@pytest.mark.slow
def test_packages_of_debian_exist() -> None:
    if shutil.which("apt-cache") is None:
        pytest.skip("no apt-cache")
    names = sorted({name for ways in WAYS.values() for name in ways.apt})
    found = subprocess.run(
        ["apt-cache", "--no-all-versions", "show", *names],
        capture_output=True,
        text=True,
        check=False,
    )
    shown = {line.split()[1] for line in found.stdout.splitlines() if line.startswith("Package:")}
    assert shown == set(names), found.stderr


def test_a_folder_that_is_not_installed_requires_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> list[str]:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", absent)
    assert [each.name for each in packages.packages()] == ["xarray"]
