"""Build the wheel and the source archive, the same bytes from the same files on any day, by anyone.

What a build leaves to chance is taken out afterwards: times, owners and modes of the members, and
their order. The versions of the tools that build are those of the lock.
"""

from __future__ import annotations

import gzip
import io
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DIST = ROOT / "dist"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first that a zip archive knows
_EPOCH_S = 315_532_800
_FILE, _FOLDER = 0o100644, 0o755


def level_wheel(content: bytes) -> bytes:
    """The same wheel with members in order, of one date and of one mode."""
    made = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(content)) as given,
        zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as level,
    ):
        for name in sorted(given.namelist()):
            member = zipfile.ZipInfo(name, _EPOCH)
            member.compress_type, member.external_attr = zipfile.ZIP_DEFLATED, _FILE << 16
            member.create_system = 3
            level.writestr(member, given.read(name))
    return made.getvalue()


def level_archive(content: bytes) -> bytes:
    """The same source archive with members in order, of one date, of nobody and of one mode."""
    made = io.BytesIO()
    with (
        tarfile.open(fileobj=io.BytesIO(content)) as given,
        tarfile.open(fileobj=made, mode="w", format=tarfile.PAX_FORMAT) as level,
    ):
        for member in sorted(given.getmembers(), key=lambda each: each.name):
            plain = tarfile.TarInfo(member.name)
            plain.mtime, plain.size, plain.type = _EPOCH_S, member.size, member.type
            plain.mode = _FOLDER if member.isdir() else _FILE & 0o777
            level.addfile(plain, given.extractfile(member) if member.isfile() else None)
    return gzip.compress(made.getvalue(), compresslevel=9, mtime=0)


def build(dist: Path = DIST) -> list[Path]:
    """Build both into a folder that holds nothing else afterwards; their paths."""
    for folder in (ROOT / "build", dist):
        shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(dist), str(ROOT)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    (wheel,), (archive,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    wheel.write_bytes(level_wheel(wheel.read_bytes()))
    archive.write_bytes(level_archive(archive.read_bytes()))
    return [wheel, archive]


if __name__ == "__main__":
    from hashlib import sha256

    for path in build():
        sys.stdout.write(f"{sha256(path.read_bytes()).hexdigest()}  {path.relative_to(ROOT)}\n")
