"""Lists of hashes signed by a command of the user's: in the folder with them, or nothing is new."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from dqforge.machines.errors import InputError
from dqforge.reports.output.folder import put_output
from dqforge.reports.output.signatures import check_signature, command_words
from dqforge.reports.run_folder import MANIFEST

_PYTHON = shlex.quote(sys.executable)
_SIGN = "import hashlib, sys, pathlib; p = pathlib.Path(sys.argv[1]); "
_SIGN += "q = pathlib.Path(sys.argv[1] + '.sig'); d = hashlib.sha256(p.read_bytes()).hexdigest(); "


def command(code: str) -> str:
    """A command of Python that gets the file."""
    return f"{_PYTHON} -c {shlex.quote(code)} {{}}"


SIGN = command(f"{_SIGN} q.write_text(d)")
CHECK = command(f"{_SIGN} sys.exit(q.read_text() != d)")


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_signature_lies_beside_its_list_and_is_one_of_it(tmp_path: Path) -> None:
    put_output(tmp_path / "out", "run", {"a.h": b"1"}, sign=SIGN)
    assert set(content(tmp_path / "out")) == {"a.h", MANIFEST, f"{MANIFEST}.sig"}
    assert check_signature(CHECK, tmp_path / "out").startswith("signature: ")
    put_output(tmp_path / "out", "run", {"a.h": b"2"}, sign=SIGN)
    check_signature(CHECK, tmp_path / "out")
    put_output(tmp_path / "out", "run", {"a.h": b"3"})  # which nobody signed
    with pytest.raises(InputError, match=r"--signature .*: it ended with 1"):
        check_signature(CHECK, tmp_path / "out")


@pytest.mark.parametrize(
    ("sign", "said"),
    [
        (command(f"{_SIGN} sys.exit('the key is\\nnot there')"), "with 1: the key is not there"),
        (command("pass"), r"it wrote no dqforge-manifest.json.\*"),
        (command(f"{_SIGN} q.write_text(d); p.write_text(d)"), "it changed dqforge-manifest.json"),
        ("no-such-program-anywhere {}", "cannot be started"),
    ],
)
@pytest.mark.parametrize("exists", [False, True])
def test_a_command_that_fails_leaves_the_folder_as_it_was(
    sign: str, said: str, exists: bool, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    if exists:
        put_output(out, "run", {"a.h": b"1"}, sign=SIGN)
    before = content(out) if exists else {}
    with pytest.raises(InputError, match=said) as refused:
        put_output(out, "run", {"a.h": b"2"}, sign=sign)
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code == 2
    assert (content(out) if out.exists() else {}) == before


@pytest.mark.parametrize(("text", "said"), [("minisign -S", "no {} for"), ("sign '{}", "close")])
def test_a_command_without_the_file_is_refused_before_it_is_needed(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        command_words(text, "--sign")


def test_no_shell_reads_the_command(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wrote no"):
        put_output(
            tmp_path / "out", "run", {"a.h": b"1"}, sign=f"{command('pass')}; touch {tmp_path}/x"
        )
    assert [*tmp_path.iterdir()] == []
