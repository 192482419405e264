"""A fixed header from the folder that `dqforge run` wrote: the emitted constants of its reference
and of its loops.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.yields import FixedHeader, FixedLoop
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.output.folder import Manifest, from_bytes, sha256
from dqforge.reports.output.recomputation import read_listed
from dqforge.reports.pages.templating import strict_json
from dqforge.reports.run_folder import MANIFEST, RESULT

_AGAIN = "run the design again"


def read_fixed_header(folder: Path) -> FixedHeader:
    """The header of a folder as it was emitted.

    Args:
        folder: What `dqforge run` wrote.

    Raises:
        InputError: It is not what dqforge wrote, it was changed since, or it has no current
            reference.
    """
    manifest, contents = read_listed(folder)
    return _checked(manifest, contents, str(folder))


def fixed_header(files: Mapping[str, bytes], source: str) -> FixedHeader:
    """The header of a folder whose files were read before.

    Args:
        files: Contents by their names in the folder, with the manifest.
        source: Name of the folder for messages.

    Raises:
        InputError: As `read_fixed_header`.
    """
    try:
        manifest = from_bytes(files.get(MANIFEST, b""))
    except ValueError as error:
        raise InputError(
            f"is not what dqforge wrote; {_AGAIN}", source=f"{source}/{MANIFEST}"
        ) from error
    return _checked(manifest, files, source)


def _checked(manifest: Manifest, contents: Mapping[str, bytes], source: str) -> FixedHeader:
    """The header that a result describes; every file that is there is as the manifest lists it."""
    for name, digest in manifest.files.items():
        content = contents.get(name)
        if content is not None and not _is_listed(content, digest):
            raise InputError(
                f"was changed since the run that wrote it; {_AGAIN}", source=f"{source}/{name}"
            )
    result, where = contents.get(RESULT), f"{source}/{RESULT}"
    if result is None or RESULT not in manifest.files:
        raise InputError(f"has no {RESULT}; {_AGAIN}", source=source)
    try:
        return header_from_plain(strict_json(result))
    except InputError as error:
        raise InputError(error.message, source=where) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON; {_AGAIN}", source=where) from error


def _is_listed(content: bytes, digest: str) -> bool:
    """Whether a content is the listed one, whatever an editor made of the ends of its lines."""
    plain = content.replace(b"\r\n", b"\n")
    return digest in (sha256(content), sha256(plain), sha256(plain.replace(b"\n", b"\r\n")))


def header_from_plain(result: Mapping[str, Any]) -> FixedHeader:
    """The header that a result describes.

    Args:
        result: What `result.json` holds.

    Raises:
        InputError: An entry that the header is made of is missing, or is not what dqforge writes.
    """
    drive, header = _entry(result, "drive"), _entry(result, "header")
    gains = result.get("gains")
    return FixedHeader(
        reference=from_plain(_entry(header, "reference", "header.reference")),
        i_d=_loop(gains, "i_d"),
        i_q=_loop(gains, "i_q"),
        v_dc=_number(drive, "v_dc_V", "drive"),
        speed=(
            None
            if drive.get("reference_omega_m_rad_per_s") is None
            else _number(drive, "reference_omega_m_rad_per_s", "drive")
        ),
        digest=str(_entry(result, "input").get("digest", "")),
    )


def _entry(plain: Mapping[str, Any], key: str, name: str = "") -> Mapping[str, Any]:
    value = plain.get(key)
    if not isinstance(value, Mapping):
        raise InputError(f"{name or key} is missing: no current reference to meet; {_AGAIN}")
    return value


def _loop(gains: object, loop: str) -> FixedLoop | None:
    plain = gains.get(loop) if isinstance(gains, Mapping) else None
    if not isinstance(plain, Mapping):
        return None
    kp, ki_ts, t_s = (_number(plain, key, f"gains.{loop}") for key in ("kp", "ki_ts", "t_s"))
    return FixedLoop.emitted(kp, ki_ts, t_s)


def _number(plain: Mapping[str, Any], key: str, where: str) -> float:
    value = plain.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}.{key} must be a finite number, got {value!r}; {_AGAIN}")
    return float(value)
