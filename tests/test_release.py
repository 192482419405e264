"""What a release is made of: the same bytes twice, one version everywhere, every part named."""

from __future__ import annotations

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import yaml

import dqforge

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Where conda-forge calls a package otherwise than the index of Python packages.
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def built_in(folder: Path, umask: int, zone: str) -> dict[str, str]:
    """Hashes of what a copy of the checkout in ``folder`` builds."""
    ignored = shutil.ignore_patterns(
        ".git", ".venv", ".typing", "build", "dist", "out", "*.egg-info", ".*_cache", "__pycache__"
    )
    shutil.copytree(ROOT, folder, ignore=ignored, copy_function=shutil.copy)
    environment = os.environ | {"TZ": zone, "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run(
        [sys.executable, "release/build_distributions.py"],
        cwd=folder,
        env=environment,
        umask=umask,
        check=True,
        capture_output=True,
    )
    return {
        path.name: sha256(path.read_bytes()).hexdigest() for path in (folder / "dist").iterdir()
    }


@pytest.mark.slow
def test_two_builds_are_the_same_bytes(tmp_path: Path) -> None:
    """Elsewhere, with another mask of modes, on copies of other dates and in another time zone."""
    first = built_in(tmp_path / "first", 0o077, "Asia/Tokyo")
    assert {name.rpartition(".")[2] for name in first} == {"whl", "gz"}
    assert built_in(tmp_path / "elsewhere" / "second", 0o022, "UTC") == first


def test_levelling_takes_out_chance_alone() -> None:
    """An archive of the same members in another order, of other dates, owners and modes."""
    import io
    import tarfile
    import zipfile

    tools = runpy.run_path(str(ROOT / "release" / "build_distributions.py"))
    members = {"x/a.py": b"a = 1\n", "x/b.py": b"b = 2\n"}

    def wheel(names: list[str], year: int, mode: int) -> bytes:
        made = io.BytesIO()
        with zipfile.ZipFile(made, "w") as archive:
            for name in names:
                member = zipfile.ZipInfo(name, (year, 2, 3, 4, 5, 6))
                member.external_attr = mode << 16
                archive.writestr(member, members[name])
        return made.getvalue()

    def archive(names: list[str], seconds: int, mode: int) -> bytes:
        made = io.BytesIO()
        with tarfile.open(fileobj=made, mode="w:gz") as packed:
            for name in names:
                member = tarfile.TarInfo(name)
                member.mtime, member.mode, member.uname = seconds, mode, f"user{mode}"
                member.size = len(members[name])
                packed.addfile(member, io.BytesIO(members[name]))
        return made.getvalue()

    names = list(members)
    one, other = wheel(names, 2001, 0o600), wheel(names[::-1], 2020, 0o755)
    assert tools["level_wheel"](one) == tools["level_wheel"](other)
    with zipfile.ZipFile(io.BytesIO(tools["level_wheel"](one))) as level:
        assert {name: level.read(name) for name in level.namelist()} == members
    tar_one, tar_other = archive(names, 5, 0o600), archive(names[::-1], 9, 0o644)
    assert tools["level_archive"](tar_one) == tools["level_archive"](tar_other)
    with tarfile.open(fileobj=io.BytesIO(tools["level_archive"](tar_one))) as plain:
        read = {each.name: plain.extractfile(each) for each in plain.getmembers()}
        assert {name: file.read() for name, file in read.items() if file} == members


def test_one_version_is_told_everywhere() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    recipe = yaml.safe_load(
        (ROOT / "release" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    )
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert newest is not None
    told = {cited["version"], recipe["context"]["version"], newest[1]}
    assert told == {dqforge.__version__}
    assert re.fullmatch(r"\d+\.\d+\.\d+", dqforge.__version__)
    assert cited["license"] == recipe["about"]["license"] == PROJECT["license"]


def test_the_conda_recipe_asks_for_what_the_package_asks_for() -> None:
    recipe = yaml.safe_load(
        (ROOT / "release" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    )
    wanted = [re.sub(r"(>=)", r" \1", line) for line in PROJECT["dependencies"]]
    named = [re.sub(r"^\S+", lambda m: CONDA_NAMES.get(m[0], m[0]), line) for line in wanted]
    assert recipe["requirements"]["run"] == [f"python {PROJECT['requires-python']}", *named]
    entry = f"dqforge = {PROJECT['scripts']['dqforge']}"
    assert recipe["build"]["python"]["entry_points"] == [entry]


@pytest.mark.slow
def test_the_bill_of_materials_names_every_locked_package() -> None:
    tools = runpy.run_path(str(ROOT / "release" / "bill_of_materials.py"))
    text = tools["bill"]()
    assert tools["bill"]() == text
    bill: dict[str, Any] = json.loads(text)
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    locked = set(re.findall(r"^([\w.-]+)==([\w.]+)", lock, re.MULTILINE))
    assert {(part["name"], part["version"]) for part in bill["components"]} == locked
    assert bill["metadata"]["component"]["version"] == dqforge.__version__
    assert "timestamp" not in bill["metadata"]
