"""The emitted C on other systems: compiled for them by zig, run under an emulator where there is
one, and held against the model by `dqforge verify` itself.

The compiler that is named to dqforge is a script: it has zig compile for the target, and puts in
the place of the program a script that has the emulator run it.
"""

from __future__ import annotations

import fcntl
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.reports.operating_system.host_compiler import packaged_zig

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(packaged_zig() is None, reason="the extra cc is not installed"),
    # The campaign leaves them to .ci/platforms, which installs the emulators.
    pytest.mark.skipif("DQFORGE_PLATFORMS" not in os.environ, reason="asked for by .ci/platforms"),
]


@dataclass(frozen=True)
class Other:
    """A system: as zig names it, and what runs its programs here; empty where nothing does."""

    target: str
    emulator: str
    file: bytes


OTHERS = (
    Other("aarch64-linux-musl", "qemu-aarch64", b"\x7fELF"),
    Other("arm-linux-musleabihf", "qemu-arm", b"\x7fELF"),
    Other("riscv64-linux-musl", "qemu-riscv64", b"\x7fELF"),
    Other("x86_64-linux-musl", "env", b"\x7fELF"),
    Other("x86_64-windows-gnu", "wine", b"MZ"),
    Other("aarch64-windows-gnu", "", b"MZ"),
    Other("x86_64-macos", "", b"\xcf\xfa\xed\xfe"),
    Other("aarch64-macos", "", b"\xcf\xfa\xed\xfe"),
)

# Those of one system in one process: the first of them builds its libraries.
RUN = [
    pytest.param(other, marks=pytest.mark.xdist_group(other.target), id=other.target)
    for other in OTHERS
    if other.emulator
]

# Drives with settings, whose headers are many kinds at once.
DESIGNS = {
    "float32": ("paper000-ipmsm-100kw", "export.control=[float32]"),
    "q15": (
        "paper000-ipmsm-100kw",
        "export.control=[q15]",
        "fit.format=q15",
        "fit.form=polynomial",
        "control.per_unit.torque=200 N m",
    ),
    "phases": ("paper002-phase-waveforms", "export.control=[float32]"),
}


def named(other: Other) -> object:
    return other.target


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where zig keeps the libraries that it builds."""
    asked = os.environ.get("ZIG_GLOBAL_CACHE_DIR")
    return Path(asked) if asked else tmp_path_factory.mktemp("zig")


def compiler(other: Other, language: str, folder: Path, cache: Path) -> Path:
    """A script that compiles for another system."""
    zig = shlex.join([str(packaged_zig()), "cc", "-target", other.target])
    path = folder / f"{language}-{other.target}"
    lines = (
        "#!/bin/sh",
        f"export ZIG_GLOBAL_CACHE_DIR={shlex.quote(str(cache))} ZIG_LOCAL_CACHE_DIR=.zig-cache",
        f'{zig} -fno-sanitize=undefined "$@" || exit 1',
        'while [ "$1" != -o ]; do shift; done',
        'mv "$2" "$2.real.exe"',
        f"""printf '#!/bin/sh\\nexec {other.emulator} "%s" "$@"\\n' "$2.real.exe" >"$2" """,
        'chmod +x "$2"',
    )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    path.chmod(0o755)
    return path


@pytest.fixture
def abroad(
    request: pytest.FixtureRequest, tmp_path: Path, cache: Path
) -> tuple[Other, dict[str, str]]:
    """Another system, and the environment in which dqforge compiles for it; zig's libraries of C
    for it are built.
    """
    other: Other = request.param
    if shutil.which(other.emulator) is None:
        pytest.skip(f"{other.emulator} is not installed")
    c, cpp = (compiler(other, language, tmp_path, cache) for language in ("cc", "cxx"))
    (tmp_path / "first.c").write_text("int main(void) { return 0; }\n", encoding="ascii")
    for each in (c, cpp):
        made = [str(each), "-O2", "-o", f"{each.name}.exe", "first.c", "-lm"]
        subprocess.run(made, cwd=tmp_path, check=True, timeout=600)
    wine = {"WINEPREFIX": str(cache / "wine"), "WINEDEBUG": "-all"}
    if other.emulator == "wine":  # its first start makes a system, for some time
        started = os.environ | wine
        first = [tmp_path / f"{c.name}.exe"]
        with (cache / "wine.lock").open("w") as lock:  # two first starts at once fail
            fcntl.flock(lock, fcntl.LOCK_EX)
            subprocess.run(first, cwd=tmp_path, env=started, check=True, timeout=600)
    return other, os.environ | wine | {"DQFORGE_CC": str(c), "DQFORGE_CXX": str(cpp)}


def dqforge(*words: str, cwd: Path, environment: dict[str, str] | None = None) -> str:
    """What a command prints."""
    done = subprocess.run(
        [sys.executable, "-m", "dqforge.cli", *words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the headers of each of `DESIGNS`."""
    place = tmp_path_factory.mktemp("exported")
    for folder, (design, *settings) in DESIGNS.items():
        sets = [word for setting in settings for word in ("--set", setting)]
        dqforge("run", design, *sets, "--no-verify", "-o", folder, cwd=place)
    return place


SIMULATED = ("simulate", "paper001-pmsm-bench", "-o", "out")
Samples = dict[str, NDArray[Any]]


def samples(folder: Path) -> Samples:
    content = (folder / "out" / "bench001_simulation.npz").read_bytes()
    with np.load(io.BytesIO(content)) as archive:
        return dict(archive)


@pytest.fixture(scope="session")
def here(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    """The simulated drive on this system."""
    folder = tmp_path_factory.mktemp("here")
    dqforge(*SIMULATED, cwd=folder)
    return samples(folder)


@pytest.mark.parametrize("abroad", RUN, indirect=True)
@pytest.mark.parametrize("folder", DESIGNS)
def test_the_headers_give_the_bits_of_the_model(
    folder: str, abroad: tuple[Other, dict[str, str]], exported: Path
) -> None:
    _, environment = abroad
    said = dqforge("verify", folder, cwd=exported, environment=environment)
    found = re.search(r"(\d+) results equal the model bit for bit, compiled as (.*)", said)
    assert found, said
    assert int(found[1]) > 10_000
    assert found[2].strip() == "C99 and C++11"


@pytest.mark.parametrize("abroad", RUN, indirect=True)
def test_the_simulated_drive_is_the_same_up_to_the_library_of_functions(
    abroad: tuple[Other, dict[str, str]], here: Samples, tmp_path: Path
) -> None:
    """Sine and cosine of another library of C differ in the last digit."""
    _, environment = abroad
    dqforge(*SIMULATED, cwd=tmp_path, environment=environment)
    there = samples(tmp_path)
    assert here.keys() == there.keys()
    for name in here:
        if here[name].dtype.kind != "f":
            continue
        # What a drive does not have is no number in either.
        scale = float(np.max(np.abs(here[name]), initial=1e-12, where=~np.isnan(here[name])))
        assert np.allclose(here[name], there[name], rtol=0.0, atol=1e-4 * scale, equal_nan=True), (
            name
        )


@pytest.mark.parametrize("other", OTHERS, ids=named)
@pytest.mark.parametrize("language", ["c", "c++"])
def test_the_headers_compile_and_link(
    language: str, other: Other, exported: Path, tmp_path: Path, cache: Path
) -> None:
    """Every header of a folder in one program, warnings as errors, for systems without an emulator
    too.
    """
    standard = {"c": "c99", "c++": "c++11"}[language]
    for folder in DESIGNS:
        headers = sorted(path.name for path in (exported / folder).glob("*.h"))
        includes = "".join(f'#include "{name}"\n' for name in headers)
        source = tmp_path / f"{folder}.c"
        source.write_text(f"{includes}int main(void) {{ return 0; }}\n", encoding="ascii")
        program = tmp_path / f"{folder}.exe"
        strict = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror")
        words = ("-target", other.target, "-x", language, f"-std={standard}", "-O2", *strict)
        done = subprocess.run(
            [
                str(packaged_zig()),
                "cc",
                *words,
                "-I",
                exported / folder,
                "-o",
                program,
                source,
                "-lm",
            ],
            cwd=tmp_path,
            env=os.environ | {"ZIG_GLOBAL_CACHE_DIR": str(cache)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert program.read_bytes().startswith(other.file)
