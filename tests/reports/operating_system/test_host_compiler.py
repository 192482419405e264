"""Which compiler is taken, and that the one of the package index gives what the others give."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hidden_compilers import hide_compilers

from dqforge.machines.errors import VerificationError
from dqforge.reports.operating_system import host_compiler, system
from dqforge.reports.operating_system.host_compiler import (
    HostCompiler,
    compile_program,
    find_compiler,
    packaged_zig,
    require_compiler,
)

ZIG = pytest.mark.skipif(packaged_zig() is None, reason="the extra cc is not installed")

SOURCE = """
#include <stdio.h>
int main(void)
{
    int byte;
    while ((byte = getchar()) != EOF) {
        (void)putchar(byte);
    }
    return 3;
}
"""


def program(folder: Path, name: str, text: str = "#!/bin/sh\nexit 0\n") -> str:
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(text, encoding="ascii")
    path.chmod(0o755)
    return str(path)


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH of one folder, without compilers; no variable names one."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr(host_compiler, "packaged_zig", lambda: None)
    for name in (*host_compiler.VARIABLES.values(), "CC", "CXX"):
        monkeypatch.delenv(name, raising=False)
    return folder


def test_the_order_in_which_compilers_are_taken(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find_compiler() is None
    monkeypatch.setattr(host_compiler, "packaged_zig", lambda: tmp_path / "zig")
    assert find_compiler() == HostCompiler("c", "zig cc", (str(tmp_path / "zig"), "cc"), zig=True)
    on_path = program(path, "zig")
    assert require_compiler("c++").command == (on_path, "cc")
    for name in ("clang", "gcc", "cc"):
        made = program(path, name)
        assert require_compiler().command == (made,)
        assert require_compiler().flags == ()
    for name in ("clang++", "g++", "c++"):
        made = program(path, name)
        assert require_compiler("c++").command == (made,)
    own = program(tmp_path / "own", "gcc-99")
    monkeypatch.setenv("DQFORGE_CC", f"'{own}' -m64")
    assert require_compiler().command == (own, "-m64")
    assert require_compiler("c++").name == "c++"


def test_a_compiler_for_the_target_is_left_alone(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = program(path, "cc")
    monkeypatch.setenv("CC", program(path, "arm-none-eabi-gcc"))
    assert require_compiler().command == (made,)


def test_a_named_compiler_that_is_not_there_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program(path, "cc")
    monkeypatch.setenv("DQFORGE_CC", "gcc-98")
    with pytest.raises(VerificationError, match="DQFORGE_CC names gcc-98, which is not there"):
        find_compiler()


def test_none_at_all_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    hide_compilers(monkeypatch)
    with pytest.raises(VerificationError, match=r"^no C compiler found: .*'dqforge\[cc\]'"):
        require_compiler()


def test_flags_and_caches_of_zig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ZIG_GLOBAL_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    zig = HostCompiler("c", "zig cc", ("zig", "cc"), zig=True)
    assert zig.flags == ("-fno-sanitize=undefined", "-mcpu=baseline")
    other = HostCompiler("c", "zig cc", ("zig", "cc", "-target", "aarch64-macos"), zig=True)
    assert other.flags == ("-fno-sanitize=undefined",)
    found = zig.environment(tmp_path)
    assert found["ZIG_LOCAL_CACHE_DIR"] == str(tmp_path / ".zig-cache")
    assert found["ZIG_GLOBAL_CACHE_DIR"] == str(tmp_path / "cache" / "zig")
    blocked = tmp_path / "file"
    blocked.write_bytes(b"")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert zig.environment(tmp_path)["ZIG_GLOBAL_CACHE_DIR"] == str(tmp_path / ".zig-libraries")
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", "/theirs")
    assert zig.environment(tmp_path)["ZIG_GLOBAL_CACHE_DIR"] == "/theirs"
    plain = HostCompiler("c", "cc", ("cc",)).environment(tmp_path)
    assert "ZIG_LOCAL_CACHE_DIR" not in plain


def test_the_compiler_of_macos_that_only_asks_to_be_installed_is_none(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(system, "MACOS", True)
    asks = program(path, "xcode-select", "#!/bin/sh\nexit 2\n")
    found = {"cc": "/usr/bin/cc", "xcode-select": asks}
    monkeypatch.setattr(shutil, "which", found.get)
    assert find_compiler() is None
    program(path, "xcode-select")
    assert require_compiler().command == ("/usr/bin/cc",)


def test_on_windows_streams_are_set_to_bytes(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler is one that notes what it is asked for."""
    monkeypatch.setattr(system, "WINDOWS", True)
    program(path, "clang")
    program(path, "gcc", '#!/bin/sh\necho "$@" >asked.txt\n')
    compiler = require_compiler()
    assert compiler.name == "gcc"
    (tmp_path / "main.c").write_text(SOURCE, encoding="ascii")
    compile_program(compiler, ("-O2",), "main.c", tmp_path, "main", "it does not compile")
    asked = (tmp_path / "asked.txt").read_text(encoding="ascii")
    assert asked.split()[-3:] == ["main.c", "binary_streams.c", "-lm"]
    assert "_O_BINARY" in (tmp_path / "binary_streams.c").read_text(encoding="ascii")


@ZIG
def test_zig_compiles_c_and_says_what_is_wrong(tmp_path: Path) -> None:
    zig = HostCompiler("c", "zig cc", (str(packaged_zig()), "cc"), zig=True)
    (tmp_path / "main.c").write_text(SOURCE, encoding="ascii")
    made = compile_program(zig, ("-std=c99", "-O2"), "main.c", tmp_path, "main", "no")
    done = subprocess.run([made], input=b"a\r\n\x1a\xff", capture_output=True, check=False)
    assert (done.stdout, done.returncode) == (b"a\r\n\x1a\xff", 3)
    (tmp_path / "main.c").write_text("#error broken\n", encoding="ascii")
    with pytest.raises(VerificationError, match=r"^it fails with zig cc: main.c:1:2: error: brok"):
        compile_program(zig, (), "main.c", tmp_path, "main", "it fails")


@pytest.mark.slow
@ZIG
@pytest.mark.parametrize(
    "command",
    [
        ("run", "paper000-ipmsm-100kw"),
        ("run", "paper002-phase-waveforms"),
        ("simulate", "paper001-pmsm-bench"),
    ],
    ids="-".join,
)
def test_without_compilers_the_command_writes_the_same_bytes(
    command: tuple[str, str], tmp_path: Path
) -> None:
    """Once with the compilers of this machine, once on a PATH that has none; the manifest alone
    says which compiler it was.
    """
    if shutil.which("cc") is None or shutil.which("c++") is None:
        pytest.skip("no compilers to hold it against")
    empty = tmp_path / "bin"
    empty.mkdir()
    written = []
    for out, places in (("with", os.environ["PATH"]), ("without", str(empty))):
        environment = os.environ | {"PATH": places}
        words = [sys.executable, "-m", "dqforge.cli", *command, "-o", out]
        done = subprocess.run(
            words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        files = [path for path in (tmp_path / out).rglob("*") if path.is_file()]
        written.append({path.name: path.read_bytes() for path in files})
    manifests = [json.loads(files.pop("dqforge-manifest.json")) for files in written]
    assert written[0] == written[1]
    with_own, without = ([*manifest["parts"].values()] for manifest in manifests)
    assert without[0]["computed_with"].pop("compiler") == "zig cc"
    assert with_own[0]["computed_with"].pop("compiler") != "zig cc"
    assert with_own == without
