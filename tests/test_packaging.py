"""The wheel holds exactly the package, its library and its templates,
and the import order of the house is kept.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FLOORS = ("checker", "machines", "optimizer", "reports")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """A wheel built from a copy of the tracked and new files, under a folder
    that is not called dqforge.
    """
    copy = tmp_path_factory.mktemp("build") / "checkout"
    ignored = shutil.ignore_patterns(
        ".git", ".venv", ".typing", "build", "dist", "out", "*.egg-info", ".*_cache", "__pycache__"
    )
    shutil.copytree(ROOT, copy, ignore=ignored)
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(copy / "dist"),
        str(copy),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    (path,) = (copy / "dist").glob("*.whl")
    return zipfile.ZipFile(path)


def expected_files() -> set[str]:
    paths = [ROOT / name for name in ("__init__.py", "cli.py", "py.typed")]
    for floor in FLOORS:
        paths += [*(ROOT / floor).rglob("*.py"), *(ROOT / floor).rglob("*.j2")]
        paths += [
            path for end in ("js", "css", "c", "h") for path in (ROOT / floor).rglob(f"*.{end}")
        ]
    paths += (ROOT / "machines" / "library").rglob("*.yaml")
    paths += (ROOT / "machines" / "library" / "schemas").glob("*.json")
    return {f"dqforge/{path.relative_to(ROOT).as_posix()}" for path in paths}


def test_the_map_of_the_code_names_every_room() -> None:
    text = (ROOT / "docs" / "project" / "architecture.md").read_text()
    rooms = {path.parent for floor in FLOORS for path in (ROOT / floor).rglob("__init__.py")}
    missing = [room.name for room in rooms if f"`{room.name}`" not in text]
    assert not missing, f"docs/project/architecture.md does not name {', '.join(missing)}"


def test_every_room_is_a_package() -> None:
    """What setuptools installs is a list of rooms: it must be the list of folders with modules."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    rooms = {path.parent for floor in FLOORS for path in (ROOT / floor).rglob("*.py")}
    found = {"dqforge"} | {f"dqforge.{'.'.join(room.relative_to(ROOT).parts)}" for room in rooms}
    assert set(settings["tool"]["setuptools"]["packages"]) == found
    assert all((room / "__init__.py").exists() for room in rooms)


@pytest.mark.slow
def test_wheel_holds_exactly_the_package(wheel: zipfile.ZipFile) -> None:
    names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert names == expected_files()


@pytest.mark.slow
def test_wheel_installs_the_command_and_the_licence(wheel: zipfile.ZipFile) -> None:
    entry = next(name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    assert "dqforge = dqforge.cli:main" in wheel.read(entry).decode()
    assert any(name.endswith("licenses/LICENSE") for name in wheel.namelist())
    metadata = next(name for name in wheel.namelist() if name.endswith("METADATA"))
    assert "License-Expression: Apache-2.0" in wheel.read(metadata).decode()


def test_help_imports_nothing_heavy() -> None:
    """`dqforge --help` must not pay for numerics, plots or templates."""
    heavy = ("numpy", "scipy", "matplotlib", "nlopt", "pint", "pydantic", "jinja2", "rich", "yaml")
    program = (
        "import sys\nfrom dqforge import cli\n"
        "try:\n    cli.main(['--help'])\nexcept SystemExit:\n    pass\n"
        f"print([name for name in {heavy!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stderr.strip() == "[]"


# What a plain installation brings for single tasks, by the name that is imported.
CARD = ("casadi", "nlopt", "numpy", "cvxpy", "osqp", "yaml")


def loaded_by(*arguments: str) -> tuple[set[str], int]:
    """Which packages of the card a command of its own process imports, and its exit code."""
    program = (
        "import sys\nfrom dqforge import cli\ncode = 0\n"
        f"try:\n    code = cli.main({list(arguments)!r})\nexcept SystemExit as end:\n"
        "    code = end.code\n"
        f"print(*[name for name in {CARD!r} if name in sys.modules], file=sys.stderr)\n"
        "sys.exit(code or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    return set(
        done.stderr.splitlines()[-1].split()
    ) if done.stderr.strip() else set(), done.returncode


def test_neither_help_nor_check_loads_what_they_do_not_need() -> None:
    """The design reader takes numpy and YAML; a machine in phase quantities needs no more."""
    assert loaded_by("--help") == (set(), 0)
    assert loaded_by("check", "salient-phase-waveforms") == ({"numpy", "yaml"}, 0)


@pytest.mark.parametrize(
    ("most", "command"),
    [
        (19, "--help"),
        (90, "check paper000-ipmsm-100kw"),
        (117, "mtpa paper000-ipmsm-100kw"),
        (149, "tune vdyno-trampa-6340"),
    ],
)
def test_commands_load_modules_that_they_use(most: int, command: str) -> None:
    program = (
        "import sys\nfrom dqforge import cli\n"
        f"try:\n    cli.main({command.split()!r})\nexcept SystemExit:\n    pass\n"
        "print(sum(name.startswith('dqforge.') for name in sys.modules), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert 10 < int(done.stderr.splitlines()[-1]) <= most


@pytest.mark.slow
def test_each_package_of_the_card_is_loaded_where_it_works_alone(tmp_path: Path) -> None:
    from dqforge.machines.design import catalogue

    design = tmp_path / "flux.yaml"
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    flux = re.sub(r"    pole: \{value: 900 rad/s[^\n]*\n", "    method: flux\n", text)
    assert flux != text
    # calm enough for the observer's lag at every corner of the tolerances, too calm for ten bits
    flux = flux.replace("    q_formats: [10, 10]\n", "")
    flux = flux.replace("0.09549296585513721", "0.00058").replace("5.968310365946075", "0.00091")
    design.write_text(flux, encoding="utf-8")
    assert loaded_by("check", str(design)) == ({"numpy", "yaml"}, 0)
    assert loaded_by("dqy", "paper002-phase-waveforms") == ({"numpy", "yaml", "osqp"}, 0)
    assert loaded_by("dqy", "salient-phase-waveforms") == ({"numpy", "yaml", "casadi"}, 0)
    assert loaded_by("tune", "paper000-ipmsm-100kw") == ({"numpy", "yaml"}, 0)
    found, code = loaded_by("tune", str(design))
    assert code == 0
    assert found - {"osqp", "nlopt"} == {
        "numpy",
        "yaml",
        "cvxpy",
    }  # cvxpy looks which of its solvers are there


def test_a_plain_installation_brings_the_whole_card() -> None:
    """No extra is needed for any of them, and the locked versions that `make
    demo` installs hold them all.
    """
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    plain = {line.split(">")[0] for line in project["dependencies"]}
    locked = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    for name in CARD:
        package = {"yaml": "pyyaml"}.get(name, name)
        assert package in plain
        assert f"\n{package}==" in f"\n{locked}"


def test_only_two_modules_lie_in_the_root() -> None:
    assert {path.name for path in ROOT.glob("*.py")} == {"__init__.py", "cli.py"}
