"""What the Containerfile says holds in this tree: versions, files and users, without an image."""

from __future__ import annotations

import fnmatch
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def steps() -> list[tuple[str, str]]:
    """Instructions of the file with what follows each, lines joined, comments left out."""
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    plain = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    joined = plain.replace("\\\n", " ").splitlines()
    return [
        (first, " ".join(rest.split()))
        for first, _, rest in (line.partition(" ") for line in joined if line.strip())
    ]


def said(instruction: str) -> list[str]:
    return [rest for first, rest in steps() if first == instruction]


def project() -> dict[str, object]:
    found: dict[str, object] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))[
        "project"
    ]
    return found


def ignored(name: str) -> bool:
    """Whether a path of the tree, or a folder above it, is kept out of the build."""
    patterns = (ROOT / ".dockerignore").read_text("utf-8").split()
    parts = Path(name).parts
    above = ["/".join(parts[: k + 1]) for k in range(len(parts))]
    return any(
        fnmatch.fnmatch(path, pattern)
        or (pattern.startswith("**/") and fnmatch.fnmatch(Path(path).name, pattern[3:]))
        for pattern in patterns
        for path in above
    )


def tracked() -> list[str]:
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("no git checkout")
    return listed.stdout.splitlines()


def test_python_is_the_least_that_the_package_takes_and_the_lock_was_made_for() -> None:
    (image,) = said("FROM")
    version = re.fullmatch(r"python:(\d+\.\d+)-slim", image)
    assert version is not None
    assert f">={version[1]}" == project()["requires-python"]
    made_for = re.findall(r"--python-version (\S+)", (ROOT / "Makefile").read_text("utf-8"))
    assert set(made_for) == {version[1]}


def test_what_is_copied_is_there() -> None:
    for rest in said("COPY"):
        *sources, _ = shlex.split(rest)
        for source in sources:
            assert (ROOT / source).exists()
            assert source == "." or not ignored(source)


def test_the_build_gets_all_of_the_package_and_little_else() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]
    rooms = {
        name.removeprefix("dqforge").strip(".").replace(".", "/") for name in table["packages"]
    }
    named = {"pyproject.toml", "LICENSE", "README.md", "requirements.lock"}
    for name in tracked():
        of_package = name.split("/")[0] in {room.split("/")[0] for room in rooms if room}
        if of_package or name in named or ("/" not in name and name.endswith(".py")):
            assert not ignored(name), name
    assert all(ignored(name) for name in ("tests/house.py", "docs/index.md", ".git/config"))
    assert ignored("machines/__pycache__/x.pyc")
    assert ignored("reports/.ruff_cache/x")


def test_packages_are_locked_and_no_optional_part_is_among_them() -> None:
    installs = [rest for rest in said("RUN") if "pip install" in rest]
    assert "--require-hashes -r /source/requirements.lock" in installs[0]
    assert all("--no-deps" in rest for rest in installs[1:])
    locked = (ROOT / "requirements.lock").read_text("utf-8")
    have = {name.lower() for name in re.findall(r"^([\w.-]+)==", locked, re.MULTILINE)}
    needed = project()["dependencies"]
    assert isinstance(needed, list)
    assert {re.split(r"[<>=]", need)[0].lower() for need in needed} <= have
    assert {"setuptools"} <= have  # the second installation takes no other
    assert not {"tornado", "pyarrow", "h5py", "distributed"} & have


def test_nobody_is_root_and_the_command_is_that_of_the_package() -> None:
    kinds = [first for first, _ in steps()]
    assert said("USER") == ["dqforge"]
    assert all(kinds.index("USER") > k for k, kind in enumerate(kinds) if kind in {"RUN", "COPY"})
    assert said("ENTRYPOINT") == ['["dqforge"]']
    assert said("WORKDIR") == ["/work"]
    scripts = project()["scripts"]
    assert isinstance(scripts, dict)
    assert "dqforge" in scripts


def test_the_page_runs_what_is_built_in_the_folder_that_it_works_in() -> None:
    page = (ROOT / "docs" / "how-to" / "install.md").read_text("utf-8")
    assert "docker build -t dqforge -f Containerfile ." in page
    run = re.search(r"docker run .*", page)
    assert run is not None
    assert '--user "$(id -u):$(id -g)"' in run[0]
    assert f'-v "$PWD":{said("WORKDIR")[0]} dqforge ' in run[0]
