"""The two sides of a comparison: a design that is solved now, the result of an earlier run,
or a header alone.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import JudgedLoop
from dqforge.optimizer.firmware.solve import Explained, explain
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities
from dqforge.reports.current_reference.capability import CONSTANTS
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.firmware.design_made import read_file, recognised
from dqforge.reports.firmware.target import MOST_BYTES, decoded_file
from dqforge.reports.firmware.written_files import plain_drive_values, plain_loop, plain_pi
from dqforge.reports.output.folder import sha256
from dqforge.reports.pages.answer import LARGEST_FILE, LARGEST_JSON, read_output, stage
from dqforge.reports.pages.templating import FORMAT, strict_json, to_text
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run import plain_solution
from dqforge.reports.run_folder import RESULT

_PARTS = ("input", "drive", "header", "fit", "gains")


_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


_GUARD = re.compile(r"^#ifndef ([A-Za-z_][A-Za-z0-9_]*)_H$", re.MULTILINE)


_TITLE = re.compile(r"/\* \S+\.h - controller coefficients for (.+)")


_DIGEST = re.compile(r"SHA-256 ([0-9a-f]{64})")


_MACRO = re.compile(r"^#define ([A-Za-z_][A-Za-z0-9_]*) \(([^()\n]*)\)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a comparison.

    Args:
        source: What the user named.
        result: The document that `dqforge run` writes.
        macros: Values of the header's macros as they are written, by name without prefix; None
            where there is no header.
        code: The header without comments and prefixes; None where there is none.
        header_only: True where ``result`` holds nothing but the name of the design and the digest
            of its file.
        foreign: True for the configuration of another firmware: machine, limits and loops are all
            it has.
    """

    source: str
    result: PlainData
    macros: dict[str, str] | None
    code: str | None = None
    header_only: bool = False
    foreign: bool = False

    @property
    def name(self) -> str:
        """Name of the design."""
        return str(self.result.get("design", ""))

    @property
    def digest(self) -> str:
        """SHA-256 of the design file."""
        return str(self.result["input"].get("digest", ""))

    def value(self, *path: str) -> Any:
        """Entry of the result at a path of keys, None where there is none."""
        found: Any = self.result
        for key in path:
            if not isinstance(found, dict):
                return None
            found = found.get(key)
        return found


def is_written(text: str) -> bool:
    """Whether a text names what a run wrote, and no design."""
    path = Path(text)
    return path.is_dir() or path.suffix.lower() in (".json", ".h")


def read_side(text: str, load: Callable[[str], Design]) -> Side:
    """One side by what the user named: a folder, JSON file or header that `dqforge run` wrote,
    else a design.

    Args:
        text: Folder, file, or name of a library drive.
        load: Makes a design of a file or name.

    Raises:
        InputError: It is none of these; the message names what is wrong.
        NoSolutionError: The design has no solution.
    """
    if not text:
        raise InputError(
            "compare: a name is empty; write a design, a library name, or what 'dqforge run' wrote"
        )
    path = Path(text)
    if path.is_dir():
        if not (path / RESULT).exists():
            raise InputError(
                f"the folder has no {RESULT}; give the folder that 'dqforge run' or 'dqforge "
                "export' wrote",
                source=text,
            )
        return _from_result(text, path / RESULT)
    if path.suffix.lower() == ".json":
        return _from_result(text, path)
    if path.suffix.lower() == ".h":
        return _from_header(text, path)
    return solved_side(text, load(text))


def solved_side(source: str, design: Design, capabilities: Capabilities = CAPABILITIES) -> Side:
    """The side of a design, solved and emitted as `dqforge run` does, without a file being
    written.

    Args:
        source: What the user named.
        design: What is solved.
        capabilities: Those of the product, or these and some from outside.
    """
    from dqforge.optimizer.solution import solve
    from dqforge.reports.main_header import header_files

    stage("solving")
    solution = solve(design)
    prefix = design.export.prefix
    header = header_files(solution)[f"{prefix}.h"].decode("ascii")
    # Through the text, so that both sides are rounded alike.
    result = json.loads(to_text("run", design.name, plain_solution(solution, capabilities)))
    return Side(
        source,
        _with_bytes(result, source),
        header_macros(header, prefix),
        header_code(header, prefix),
    )


def header_code(header: str, prefix: str) -> str:
    """What a header compiles to: without comments, blank lines and the prefix of its names."""
    bare = re.sub(
        rf"(?<![A-Za-z0-9_]){re.escape(prefix)}(?=_)",
        "",
        _COMMENT.sub("", header),
        flags=re.IGNORECASE,
    )
    return "\n".join(
        line for line in (" ".join(text.split()) for text in bare.splitlines()) if line
    )


def header_macros(header: str, prefix: str) -> dict[str, str]:
    """Values of the macros in a header, by name without prefix and in the order of the header."""
    start = prefix.upper() + "_"
    return {
        name.removeprefix(start): value
        for name, value in _MACRO.findall(header)
        if name.startswith(start)
    }


def _read(path: Path, most_bytes: int = LARGEST_FILE) -> bytes:
    return read_output(
        path,
        "a design, a library name, or what 'dqforge run' or 'dqforge export' wrote",
        most_bytes,
    )


def _from_result(text: str, path: Path) -> Side:
    source, content = str(path), _read(path, LARGEST_JSON)
    try:
        result = strict_json(content)
    except (ValueError, RecursionError) as error:
        raise InputError(
            "is not JSON; give the result.json of 'dqforge run'", source=source
        ) from error
    if not isinstance(result, dict) or "dqforge" not in result or "command" not in result:
        raise InputError(
            "is not a result of dqforge; give the result.json of 'dqforge run'", source=source
        )
    if result["command"] != "run":
        raise InputError(
            f"is the JSON of 'dqforge {result['command']}'; only the result.json of 'dqforge run' "
            "or 'dqforge export' can be compared",
            source=source,
        )
    if result.get("format") != FORMAT:
        raise InputError(
            f"has the format {result.get('format')!r}, expected {FORMAT}; run the design again",
            source=source,
        )
    for part in _PARTS:
        if not isinstance(result.get(part), dict):
            raise InputError(
                f"{part}: is missing or no object; run the design again", source=source
            )
    macros, code = _header_beside(path, result["header"].get("prefix"))
    return Side(text, _with_bytes(result, text), macros, code)


def _with_bytes(result: PlainData, source: str) -> PlainData:
    """A result with the bytes of the constants of its reference, for `QUANTITIES`."""
    from dqforge.optimizer.current_reference.fit import reference_bytes

    header = result["header"]
    try:
        size = float(reference_bytes(from_plain(header["reference"])))
    except (InputError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            "header.reference: cannot be read; run the design again", source=source
        ) from error
    return result | {"header": header | {CONSTANTS: size}}


def _from_header(text: str, path: Path) -> Side:
    header = _read(path).decode("utf-8", errors="replace")
    guard, title, digest = _GUARD.search(header), _TITLE.match(header), _DIGEST.search(header)
    if guard is None or title is None or digest is None:
        raise InputError(
            "is no header of dqforge; give <prefix>.h of 'dqforge run' or 'dqforge export'",
            source=text,
        )
    result = {"design": title[1].strip(), "input": {"digest": digest[1]}}
    prefix = guard[1]
    return Side(
        text, result, header_macros(header, prefix), header_code(header, prefix), header_only=True
    )


def _header_beside(path: Path, prefix: object) -> tuple[dict[str, str] | None, str | None]:
    """Macros and code of the header in the folder of a result, None where there is none."""
    if not isinstance(prefix, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", prefix):
        raise InputError(
            "header.prefix: expected a C identifier; run the design again", source=str(path)
        )
    header = path.parent / f"{prefix}.h"
    if not header.is_file():
        return None, None
    content = _read(header).decode("utf-8", errors="replace")
    return header_macros(content, prefix), header_code(content, prefix)


# The configuration of another firmware as a side of a comparison: machine, limits, and gains with
# the margins that its own loops have.

_DESIGNS = (".yaml", ".yml")


def firmware_side(name: str) -> Side | None:
    """The side of a file of another firmware, None where it is none.

    Args:
        name: What the user named.

    Raises:
        InputError: It is such a file, and not what the firmware writes.
    """
    path = Path(name)
    if not path.is_file() or path.suffix.lower() in _DESIGNS:
        return None
    try:
        content = read_regular_file(path, MOST_BYTES)
        file = decoded_file(content, name)
    except InputError:
        return None  # what else it may be is refused in its own words
    target = recognised(file)
    if target is None:
        return None
    found = explain(read_file(target, file))
    return Side(name, _plain(found, target.title, sha256(content)), None, foreign=True)


def _plain(found: Explained, title: str, digest: str) -> PlainData:
    """What `quantity_rows` asks for, in the keys of ``result.json``."""
    configuration = found.configuration
    return {
        "design": f"{configuration.name} ({title})",
        "input": {"digest": digest},
        "drive": plain_drive_values(found.drive),
        "gains": {
            "i_d": _loop(configuration.current_d, found.judged.current_d),
            "i_q": _loop(configuration.current_q, found.judged.current_q),
            "speed": _loop(_per_torque(configuration), found.judged.speed),
        },
    }


def _loop(gains: PiGains | None, judged: JudgedLoop | None) -> PlainData | None:
    if gains is None:
        return None
    margins: Mapping[str, object] = plain_loop(judged) or {}
    finite = {
        key: value
        for key, value in margins.items()
        if not isinstance(value, float) or math.isfinite(value)
    }
    return {"method": "given", **(plain_pi(gains) or {}), **finite}


def _per_torque(configuration: Configuration) -> PiGains | None:
    """Gains of the speed controller in N m s/rad and N m/rad."""
    speed, drive = configuration.speed, configuration.drive
    if speed is None or drive.pole_pairs is None or not drive.psi_pm:
        return None
    constant = torque_per_ampere(drive.pole_pairs, drive.psi_pm)
    return PiGains(speed.kp * constant, speed.ki * constant)
