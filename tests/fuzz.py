"""Bytes that no one would write, for everything that dqforge reads: each is answered, or refused as
`DqforgeError`, without a warning, within 10 s and 1 GiB.

    python tests/fuzz.py --minutes 10              every reader in turn, guided by coverage
    python tests/fuzz.py --minutes 2 design map    these alone
    python tests/fuzz.py design tests/corpus/design/1a2b3c4d    one input again

An input that is not answered is kept below tests/corpus, where `tests/test_corpus.py` tries it by
default from then on. The seed is the commit, or ``DQFORGE_SEED``.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import os
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import drawn_cases

HERE = Path(__file__).parent
CORPUS = HERE / "corpus"
LIBRARY = HERE.parent / "machines" / "library"
TIMEOUT_S, MEMORY_MB = 10, 1024

LOG = b"time [s],id [A],iq [A],uq [V],w [rad/s],T [N m]\n" + b"".join(
    f"{0.1 * k:.2f},{0.01 * k - 1:.3f},{k % 7 - 3},{0.3 * (k % 5):.2f},{20 + k},0.{k}\n".encode()
    for k in range(40)
)
BENCH = b"""dqforge_bench: 1
name: Machine
machine: {pole_pairs: 4, max_current: 10 A, magnet_flux: 10 mWb, inertia: 1e-3 kg m^2}
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
runs:
- name: rows
  kind: constant-speed
  file: log.csv
  columns: {i_d: id, i_q: iq, u_q: uq, speed: w, torque: T}
  currents: measured
  voltage: reference
"""
MAP = b"i_d [A],i_q [A],psi_d [Wb],psi_q [Wb]\n" + b"".join(
    f"{i_d},{i_q},{0.1 + 1e-3 * i_d:.4f},{2e-3 * i_q:.4f}\n".encode()
    for i_d in range(-10, 1, 5)
    for i_q in range(0, 11, 5)
)
CAPTURE = b"t [ms];u [V];v [V];w [V]\n" + b"".join(
    f"{k};{k % 9 - 4};{(k + 3) % 9 - 4};{(k + 6) % 9 - 4}\n".encode() for k in range(60)
)
MACROS = (
    b"#define POLE_PAIR_NUM 4\n#define PID_TORQUE_KP_DEFAULT (int16_t)1500\n#define TF_KPDIV 512\n"
)


def design(data: bytes, folder: Path) -> None:
    """A design file."""
    from dqforge.machines.design.catalogue import load_text

    load_text(data, "design.yaml", folder)


def study(data: bytes, folder: Path) -> None:
    """A study."""
    from dqforge.machines.exploration.study_checks import read_study

    read_study(written(folder, "study.yaml", data))


def bench(data: bytes, folder: Path) -> None:
    """A bench file beside a sound log."""
    from dqforge.machines.bench.bench_reader import read_bench
    from dqforge.optimizer.identification.identify import identify

    written(folder, "log.csv", LOG)
    identify(read_bench(written(folder, "bench.yaml", data)))


def log(data: bytes, folder: Path) -> None:
    """A log beside a sound bench file; the first byte chooses its format."""
    from dqforge.machines.bench.bench_reader import read_bench
    from dqforge.optimizer.identification.identify import identify

    endings = ("csv", "json", "npz", "mat", "h5", "parquet", "txt")
    name = f"log.{endings[data[0] % len(endings)] if data else 'csv'}"
    written(folder, name, data[1:])
    bench_file = written(folder, "bench.yaml", BENCH.replace(b"log.csv", name.encode()))
    identify(read_bench(bench_file))


def flux_map(data: bytes, folder: Path) -> None:
    """A flux map; the first byte chooses its format."""
    from dqforge.machines.flux_maps.map_files import read_flux_map

    endings = ("csv", "npz", "mat", "h5", "txt", "xlsx")
    name = f"map.{endings[data[0] % len(endings)] if data else 'csv'}"
    read_flux_map(written(folder, name, data[1:]))


def capture(data: bytes, folder: Path) -> None:
    """A capture of a back-EMF; the first byte chooses its format."""
    from dqforge.machines.back_emf.capture import analyse
    from dqforge.machines.back_emf.columns import CaptureOptions, read_captures

    endings = ("csv", "mat", "csv.gz", "txt")
    name = f"cap.{endings[data[0] % len(endings)] if data else 'csv'}"
    analyse(read_captures([name], lambda _: data[1:], lambda _: False, CaptureOptions()))


def firmware(data: bytes, folder: Path) -> None:
    """A file of other firmware; the first byte chooses its format."""
    from dqforge.reports.answers.compare import answer_explain

    endings = ("h", "c", "xml", "json", "txt", "cpp", "mcserverconf")
    name = f"file.{endings[data[0] % len(endings)] if data else 'h'}"
    answer_explain((written(folder, name, data[1:]),), None)


def option(data: bytes, folder: Path) -> None:
    """A key that is set on the command line."""
    from dqforge.machines.design.catalogue import load_text

    text = (LIBRARY / "paper001-pmsm-bench.yaml").read_bytes()
    load_text(text, "design.yaml", folder, (data.decode("utf-8", "replace"),))


READERS: dict[str, Callable[[bytes, Path], None]] = {
    "design": design,
    "study": study,
    "bench": bench,
    "log": log,
    "map": flux_map,
    "capture": capture,
    "firmware": firmware,
    "option": option,
}


def written(folder: Path, name: str, data: bytes) -> Path:
    """A file with this content."""
    path = folder / name
    path.write_bytes(data)
    return path


def tried(reader: str, data: bytes) -> None:
    """Let a reader read; whatever it raises but `DqforgeError` is a fault of its."""
    from dqforge.machines.errors import DqforgeError

    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(DqforgeError):
            READERS[reader](data, Path(folder))


def seeds(reader: str) -> Iterator[bytes]:
    """Sound inputs to begin with."""
    first = {"log": LOG, "map": MAP, "capture": CAPTURE, "firmware": MACROS}
    if reader in first:
        yield b"\0" + first[reader]
    if reader == "design":
        yield from (path.read_bytes() for path in sorted(LIBRARY.glob("*.yaml")))
    if reader == "study":
        yield from (path.read_bytes() for path in sorted((LIBRARY / "studies").glob("*.yaml")))
    if reader == "bench":
        yield BENCH
    if reader == "option":
        for one in ("machine.resistance=1 Ohm", "control.observer={method: ekf}", "fit.degree=3"):
            yield one.encode()
    folder = CORPUS / reader
    if folder.is_dir():
        yield from (path.read_bytes() for path in sorted(folder.iterdir()))


def fuzz(reader: str, seconds: int, found: Path) -> None:
    """Feed a reader until something is found or the time is over; does not return."""
    import atheris

    with atheris.instrument_imports(include=["dqforge"]):
        for data in seeds(reader):
            with contextlib.suppress(Exception):
                tried(reader, data)
    begin = Path(tempfile.mkdtemp())
    for number, data in enumerate(seeds(reader)):
        written(begin, f"{number}", data)
    seed = int(hashlib.sha256(drawn_cases.seed().encode()).hexdigest()[:8], 16) % (1 << 31)
    limits = (f"-max_total_time={seconds}", f"-timeout={TIMEOUT_S}", f"-rss_limit_mb={MEMORY_MB}")
    arguments = ["fuzz", *limits, "-max_len=20000", "-print_final_stats=1", f"-seed={seed}"]
    arguments += ["-verbosity=0", f"-artifact_prefix={found}/", str(begin)]
    atheris.Setup(arguments, lambda data: tried(reader, data))
    atheris.Fuzz()


def kept(reader: str, found: Path) -> list[str]:
    """Move what was found into the corpus; a line for each that tries it again."""
    lines = []
    for path in sorted(found.iterdir()):
        data = path.read_bytes()
        place = CORPUS / reader / hashlib.sha256(data).hexdigest()[:12]
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
        lines.append(f"python tests/fuzz.py {reader} {place.relative_to(HERE.parent)}")
    return lines


def say(text: str) -> None:
    """A line on the terminal."""
    sys.stdout.write(f"{text}\n" if text else "")


def campaign(readers: list[str], seconds: int) -> int:
    """All readers for an equal share of the time; 1 if something was found."""
    faults = []
    for reader in readers:
        with tempfile.TemporaryDirectory() as folder:
            command = [
                sys.executable,
                __file__,
                reader,
                "--seconds",
                str(seconds),
                "--into",
                folder,
            ]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            again = kept(reader, Path(folder))
        stats = re.search(r"number_of_executed_units: *(\d+)", done.stderr)
        tries = stats.group(1) if stats else "few"
        say(f"{reader}: {tries} inputs, {len(again)} not answered")
        if again or done.returncode:
            faults += again or [done.stderr[-2000:]]
            say("\n".join(line for line in done.stderr.splitlines() if "Error" in line)[-600:])
    say("\n".join(faults))
    return int(bool(faults))


def main() -> int:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", help="readers, or a reader and an input")
    parser.add_argument("--minutes", type=float, help="for all readers together")
    parser.add_argument("--seconds", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.seconds is not None:
        fuzz(given.words[0], given.seconds, given.into)
    if given.minutes is None:
        reader, place = given.words
        tried(reader, Path(place).read_bytes())
        return 0
    readers = given.words or list(READERS)
    return campaign(readers, max(1, round(60.0 * given.minutes / len(readers))))


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
