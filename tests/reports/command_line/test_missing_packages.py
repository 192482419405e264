"""A package that is not installed ends every command in one line that says what to install."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path

import pytest

from dqforge import cli
from dqforge.reports.operating_system.packages import PACKAGES

ROOT = Path(__file__).parents[3]
MODULES = {"python-flint": "flint", "pyyaml": "yaml", "python-calamine": "python_calamine"}
OPTIMISED = "control.current_loop={method: optimised, max_sensitivity: 1.6}"
PHASES, SERVO = "paper002-phase-waveforms", "paper001-pmsm-bench"
LAZY = [
    ("nlopt", ["tune", SERVO, "--set", OPTIMISED]),
    ("matplotlib", ["tune", SERVO, "--plot", "a.svg"]),
    ("python-flint", ["export", SERVO, "--no-verify", "-o", "out"]),
    ("osqp", ["dqy", PHASES]),
    ("piqp", ["dqy", PHASES]),
    ("casadi", ["dqy", "salient-phase-waveforms"]),
    ("pyarrow", ["explore", "study.yaml"]),
    ("distributed", ["explore", "study.yaml"]),
]

# Every command that solves, over the solvers that its design calls: command line behind the design.
SALIENT = "salient-phase-waveforms"
KALMAN = "control.observer={method: ekf}"
WRITTEN = ["--no-verify", "-o", "out"]
SOLVED = {
    "nlopt": {
        (SERVO, "--set", OPTIMISED): {"tune", "run", "export", "simulate"},
        ("abb-ipmsm-2k2", "--set", "fit.method=lagrange"): {"fit", "run", "export"},
        (SERVO,): {"estimators"},
        ("000",): {"reproduce"},
    },
    "osqp": {(PHASES,): {"dqy", "run", "export"}, (PHASES, SERVO): {"compare"}},
    "casadi": {
        (SALIENT,): {"dqy", "run", "export"},
        (SALIENT, SERVO): {"compare"},
        (SERVO, "--set", KALMAN): {"tune", "run", "export"},
        (SERVO,): {"estimators"},
    },
}
REFUSED = [
    (package, [command, *design, *(WRITTEN if command in {"run", "export"} else [])])
    for package, designs in SOLVED.items()
    for design, commands in designs.items()
    for command in sorted(commands)
]
# What does without: the same designs where the command asks the package nothing.
ANSWERED = [
    ("nlopt", ["fit", SERVO, "--set", OPTIMISED]),
    ("osqp", ["tune", PHASES]),
    ("casadi", ["tune", SALIENT]),
    ("casadi", ["fit", SALIENT]),
    ("casadi", ["simulate", SALIENT]),
]


class Hidden:
    """A finder of modules that finds those of one package missing."""

    def __init__(self, package: str) -> None:
        self.module = MODULES.get(package, package)

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        if name.partition(".")[0] == self.module:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


@pytest.mark.parametrize(("package", "words"), LAZY, ids=[package for package, _ in LAZY])
def test_a_missing_package_is_named_with_its_installation(
    package: str,
    words: Sequence[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    study = ROOT / "machines" / "library" / "studies" / "magnets-and-inductances.yaml"
    (tmp_path / "study.yaml").write_bytes(study.read_bytes())
    hide(package, monkeypatch)
    require_one_line(package, words, capsys)


def hide(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a package be missing for as long as the test lasts."""
    hidden = Hidden(package)
    for name in [name for name in sys.modules if name.partition(".")[0] == hidden.module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [hidden, *sys.meta_path])


def require_one_line(
    package: str, words: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    printed = capsys.readouterr()
    assert end.value.code in {1, 2}
    assert printed.err.count("\n") == 1
    assert re.search(rf"{package}.*pip install '?[a-z]", printed.err), printed.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "words"), REFUSED, ids=[f"{package}-{' '.join(w[:2])}" for package, w in REFUSED]
)
def test_every_command_that_solves_refuses_in_one_line(
    package: str,
    words: Sequence[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    hide(package, monkeypatch)
    require_one_line(package, words, capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "words"), ANSWERED, ids=[f"{package}-{' '.join(w[:2])}" for package, w in ANSWERED]
)
def test_a_command_that_asks_it_nothing_answers(
    package: str,
    words: Sequence[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    hide(package, monkeypatch)
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert end.value.code == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("package", ["typer", "numpy", "pydantic"])
def test_what_every_command_needs_is_named_too(package: str, tmp_path: Path) -> None:
    """In a process of its own: these are loaded when a module begins."""
    program = (
        "import sys\n"
        f"sys.modules[{package!r}] = None\n"
        "from dqforge.cli import main\n"
        "main(['check', 'abb-ipmsm-2k2'])\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert re.search(rf"{package}.*pip install [a-z]", run.stderr)


IMPORTED = re.compile(
    r"^[ ]*(?:from ([a-z_0-9]+)[\w.]* import |import ([a-z_0-9]+)[\w.]*(?: as \w+)?$)"
    r"|import_module\(\"([a-z_0-9]+)\"\)",
    re.MULTILINE,
)
OWN_OF_A_SYSTEM = {"msvcrt", "fcntl", "winreg"}
OF_ANOTHER = {"pydantic_core": "pydantic", "dask": "distributed", "markupsafe": "jinja2"}


def test_doctor_knows_every_package_that_is_imported() -> None:
    """And none that no module imports, which was once said of what another package does."""
    imported = set()
    for floor in ("machines", "optimizer", "reports"):
        for file in (ROOT / floor).rglob("*.py"):
            for found in IMPORTED.findall(file.read_text(encoding="utf-8")):
                imported |= {name for name in found if name}
    others = imported - set(sys.stdlib_module_names) - OWN_OF_A_SYSTEM - {"dqforge"}
    names = {module: package for package, module in MODULES.items()} | OF_ANOTHER
    packages = {names.get(module, module) for module in others}
    assert set(PACKAGES) - {"ziglang", "typer"} <= packages
    assert not [name for name in packages - set(PACKAGES) if find_spec(name) is not None]
