"""What a worker must share with the process that asks, for the same bytes: versions, the sources of
dqforge, and the instruction sets that numpy uses.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path

import dqforge
from dqforge.reports.study_store.study_header import cpu_features, versions

CPU = "CPU features"
SOURCES = "sources"
# Versions that are compared before anything of dqforge is asked of a worker.
COMPARED = ("dqforge", "python", "numpy", "scipy", "pyarrow", "cloudpickle")


@cache
def source_hash() -> str:
    """SHA-256 of the modules of dqforge: one version may stand for several states of a checkout."""
    root = Path(dqforge.__file__).parent
    folders = [root / name for name in ("machines", "optimizer", "reports")]
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def worker_facts() -> dict[str, str]:
    """Facts of this process by name."""
    features = " ".join(cpu_features())
    pickler = {"cloudpickle": metadata.version("cloudpickle")}
    return versions() | pickler | {SOURCES: source_hash(), CPU: features}


def first_difference(there: Mapping[str, str], here: Mapping[str, str]) -> str:
    """What a worker has that differs from ``here``, in words; empty where nothing does.

    Args:
        there: Facts, or versions alone, of the worker.
        here: What is compared, of this process.
    """
    for name, value in here.items():
        other = there.get(name) or "none"
        if other == value:
            continue
        if name == CPU:
            return f"has other CPU features ({_features_apart(other, value)})"
        if name == SOURCES:
            return f"has other sources of dqforge {here['dqforge']}"
        return f"has {name} {other}, here is {value}"
    return ""


def _features_apart(there: str, here: str) -> str:
    ours, theirs = set(here.split()), set(there.split())
    texts = [
        f"{sorted(names)[0]}{f' and {len(names) - 1} more' * (len(names) > 1)} only {where}"
        for names, where in ((ours - theirs, "here"), (theirs - ours, "there"))
        if names
    ]
    return ", ".join(texts)
