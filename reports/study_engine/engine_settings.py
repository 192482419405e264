"""On what a study is run, as the command asks for it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Protocol

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

_ADDRESS = re.compile(r"(?:(?:tcp|tls|ws|wss|ucx)://)?[^\s/:]+|(?:(?:tcp|tls)://)?\[[0-9a-f:.%]+\]")
_MOST_PORT = 65535


def is_address(text: str) -> bool:
    """Whether a text may be the address of a scheduler: a host and a port, after a protocol.

    A client of Dask that is given another one is left half made, and complains when it is deleted.

    Args:
        text: Such as ``tcp://host:8786``.
    """
    host, _, port = text.rstrip("/").rpartition(":")
    number = int(port) if re.fullmatch(r"\d{1,5}", port) else 0
    return _ADDRESS.fullmatch(host) is not None and 1 <= number <= _MOST_PORT


class PartWriter(Protocol):
    """Where parts go."""

    def write(self, part: int, data: bytes) -> None:
        """Keep the bytes of a part."""


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Certificates in PEM format; empty texts leave them to Dask's own settings."""

    authority: str = ""
    certificate: str = ""
    key: str = ""


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """On what a study is run.

    Args:
        workers: Processes of this machine, None for as many as it has processors.
        scheduler: Address of a cluster that there is, empty for none.
        scheduler_file: File in which the scheduler wrote its address, None for none.
        tls: For a cluster that asks for it.
        mixed: Whether workers may have other CPU features.
        time_limit: Of a batch in s, None to learn it.
    """

    workers: int | None = None
    scheduler: str = ""
    scheduler_file: Path | None = None
    tls: TlsFiles = TlsFiles()
    mixed: bool = False
    time_limit: float | None = None

    def __post_init__(self) -> None:
        """Refuse an address that none can be; raises `InputError`."""
        if self.scheduler and not is_address(self.scheduler):
            raise InputError(
                f"--scheduler {self.scheduler}: expected an address such as tcp://host:8786"
            )

    @property
    def elsewhere(self) -> bool:
        """Whether a cluster that there is does the work."""
        return bool(self.scheduler) or self.scheduler_file is not None
