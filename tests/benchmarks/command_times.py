"""What commands cost: user time as multiples of a calibrating loop, beside the multiples that are
kept in the tree. Says which became slower by a fifth or more; that is a remark, and no failure.

``python tests/benchmarks/command_times.py`` runs all, or those that are named; ``--drawn 30`` those
whose turn it is at this commit, for some 30 s; ``--keep`` keeps what they took.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from drawn_cases import turn  # noqa: E402

KEPT = HERE / "command_times.json"
LIBRARY = HERE.parents[1] / "machines" / "library"
SLOWER = 1.2
UNKNOWN = 50.0
OF_EVERY_DRIVE = ("check", "run")
OF_SOME = ("tune", "mtpa", "fit", "export")
SOME = ("paper000-ipmsm-100kw", "abb-ipmsm-2k2", "salient-phase-waveforms")
OTHERS = ("--help", "schema", "machines", "export abb-ipmsm-2k2 --for moteus")


def commands() -> Iterator[str]:
    """All commands that are measured."""
    yield from OTHERS
    yield from (f"{command} {drive}" for command in OF_SOME for drive in SOME)
    drives = sorted(path.stem for path in LIBRARY.glob("*.yaml") if path.stem != "template")
    yield from (f"{command} {drive}" for drive in drives for command in OF_EVERY_DRIVE)


def loop_s() -> float:
    """User time of the calibrating loop: calls, attributes, texts, as loading and drawing are."""
    start = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    texts: dict[str, int] = {}
    for number in range(150_000):
        word = f"{number % 977}:{number * number % 7}"
        texts[word] = texts.get(word, 0) + len(word.partition(":")[0])
    return resource.getrusage(resource.RUSAGE_SELF).ru_utime - start


def multiple(command: str) -> float:
    """User time of a command, its compilers' included, over that of the loop before and after.

    Raises:
        subprocess.CalledProcessError: The command fails.
    """
    program = str(Path(sys.executable).with_name("dqforge"))
    before = loop_s()
    start = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, *command.split()], cwd=folder, capture_output=True, check=True)
    taken = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - start
    return 2.0 * taken / (before + loop_s())


def drawn(known: dict[str, float], seconds: float) -> list[str]:
    """Commands whose turn it is, as long as seconds are left."""
    left, chosen, one = seconds, [], min(loop_s() for _ in range(3))
    for command in sorted(commands(), key=turn):
        cost = known.get(command, UNKNOWN) * one
        if cost <= left:
            chosen.append(command)
            left -= cost
    return chosen


def main() -> None:
    """Measure, compare, say what became slower."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", help="in quotes, such as 'check vdyno-trampa-6340'")
    parser.add_argument("--drawn", type=float, metavar="SECONDS")
    parser.add_argument("--keep", action="store_true")
    asked = parser.parse_args()
    known: dict[str, float] = json.loads(KEPT.read_text("utf-8")) if KEPT.exists() else {}
    found, slower, begin = {}, 0, time.monotonic()
    chosen = asked.commands or list(commands())
    for command in chosen if asked.drawn is None else drawn(known, asked.drawn):
        try:
            found[command] = multiple(command)
        except subprocess.CalledProcessError as error:
            print(f"remark: {command} ends with {error.returncode}: {error.stderr.decode()[-500:]}")
            continue
        limit = SLOWER * known.get(command, float("inf"))
        # What else runs can only slow a command down: the least of three counts.
        for _ in range(2):
            if asked.keep or found[command] > limit:
                found[command] = min(found[command], multiple(command))
        before = known.get(command)
        print(f"{found[command]:8.1f}  {'' if before is None else f'{before:8.1f}'}  {command}")
        if found[command] > limit:
            slower += 1
            print(f"remark: {command} takes {found[command] / limit * SLOWER:.2f} times as long")
    print(f"{len(found)} commands, {slower} slower, in {time.monotonic() - begin:.0f} s")
    if asked.keep:
        kept = known | {name: round(value, 1) for name, value in found.items()}
        KEPT.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
