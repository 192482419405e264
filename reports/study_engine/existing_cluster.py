"""A cluster that somebody else started: found, and held to the versions of this process."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from dqforge.reports.study_engine.engine_settings import EngineSettings, TlsFiles, is_address
from dqforge.reports.study_engine.local_cluster import close_client, quiet
from dqforge.reports.study_engine.signals import deaf_to_the_terminal
from dqforge.reports.study_engine.stopped import EngineStoppedError
from dqforge.reports.study_engine.worker_facts import (
    COMPARED,
    CPU,
    first_difference,
    worker_facts,
)

if TYPE_CHECKING:
    from distributed import Client, Security

ANSWERS_WITHIN_S = 10.0
FIRST_WORKER_WITHIN_S = 120.0
_ASK_EVERY_S = 0.2


@contextmanager
def existing_workers(
    settings: EngineSettings, waits: Callable[[str], None], asked: Callable[[], bool]
) -> Iterator[Client]:
    """The cluster at the address, with at least one worker, all of them fit.

    Args:
        waits: Told what is waited for.
        asked: Whether somebody asked to stop, which ends the waiting.

    Raises:
        EngineStoppedError: Nobody answers, there is no worker, or one differs.
    """
    with quiet():
        client = _connected(settings)
        try:
            _wait_for_a_worker(client, waits, asked)
            require_fit(client, mixed=settings.mixed)
            yield client
        finally:
            close_client(client)


def _connected(settings: EngineSettings) -> Client:
    from distributed import Client

    address = settings.scheduler or _address_in(settings.scheduler_file or Path())
    if not is_address(address):
        raise EngineStoppedError(f"cannot use the scheduler at {address}: no address with a port")
    security = _security(settings.tls)
    if address.startswith("tls://") and not _has_certificates(security):
        raise EngineStoppedError(
            f"the scheduler at {address} asks for certificates; write --tls-ca-file, --tls-cert "
            "and --tls-key"
        )
    try:
        with deaf_to_the_terminal():
            return Client(
                address,
                security=security,
                timeout=ANSWERS_WITHIN_S,
                set_as_default=False,
                name="dqforge",
            )
    except (OSError, TimeoutError) as error:
        raise EngineStoppedError(
            f"no scheduler answers at {address} within {ANSWERS_WITHIN_S:g} s; start one with "
            f"'dask scheduler', or leave {_flag(settings)} out"
        ) from error
    except (ValueError, TypeError, RuntimeError) as error:
        text = " ".join(str(error).split())
        raise EngineStoppedError(f"cannot use the scheduler at {address}: {text}") from error


def _flag(settings: EngineSettings) -> str:
    return "--scheduler" if settings.scheduler else "--scheduler-file"


def _address_in(path: Path) -> str:
    """The address that a scheduler wrote; it may be about to."""
    until = time.monotonic() + ANSWERS_WITHIN_S
    while True:
        try:
            address = json.loads(path.read_text(encoding="utf-8"))["address"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            if time.monotonic() < until and not isinstance(error, IsADirectoryError):
                time.sleep(_ASK_EVERY_S)
                continue
            raise EngineStoppedError(
                f"no scheduler has written its address into {path} within {ANSWERS_WITHIN_S:g} s; "
                f"start one with 'dask scheduler --scheduler-file {path}'"
            ) from error
        return str(address)


def _has_certificates(security: Security | None) -> bool:
    """Whether the command or the settings of Dask name certificates. Without any, a client of Dask
    is left half made, and complains when it is deleted.
    """
    from distributed import Security

    found = Security() if security is None else security
    return found.get_connection_args("client").get("ssl_context") is not None


def _security(tls: TlsFiles) -> Security | None:
    """Certificates that the command names; None leaves it to Dask's settings."""
    from distributed import Security

    if tls == TlsFiles():
        return None
    missing = [path for path in (tls.authority, tls.certificate, tls.key) if not _readable(path)]
    if missing:
        raise EngineStoppedError(
            f"cannot read the certificate {missing[0]!r}; name PEM files by --tls-ca-file, "
            "--tls-cert and --tls-key"
        )
    return Security(
        tls_ca_file=tls.authority,
        tls_client_cert=tls.certificate,
        tls_client_key=tls.key or None,
        require_encryption=True,
    )


def _readable(path: str) -> bool:
    return not path or Path(path).is_file()


def _wait_for_a_worker(
    client: Client, waits: Callable[[str], None], asked: Callable[[], bool]
) -> None:
    until = time.monotonic() + FIRST_WORKER_WITHIN_S
    waits("waiting for a worker")
    while not client.nthreads() and not asked():
        if time.monotonic() > until:
            raise EngineStoppedError(
                f"no worker has joined the scheduler within {FIRST_WORKER_WITHIN_S:g} s; start "
                "some with 'dask worker', one thread each"
            )
        time.sleep(_ASK_EVERY_S)


def require_fit(client: Client, *, mixed: bool) -> None:
    """Raise `EngineStoppedError` with the first worker that would not write the same bytes.

    Versions are asked of Dask first, since a worker without dqforge cannot be asked by it.
    """
    here = compared_facts(mixed=mixed)
    libraries = [name for name in COMPARED if name != "python"]
    found = cast("Mapping[str, Any]", client.get_versions(packages=libraries))
    for address, about in sorted(found["workers"].items()):
        packages = {**about["packages"], "python": _minor(about["packages"]["python"])}
        _refuse(address, first_difference(packages, {name: here[name] for name in COMPARED}))
    facts: Mapping[str, Any] = client.run(worker_facts, on_error="return")
    for address, there in sorted(facts.items()):
        if isinstance(there, BaseException):
            _refuse(address, f"cannot load dqforge: {there}")
        _refuse(address, first_difference(there, here))


def compared_facts(*, mixed: bool) -> dict[str, str]:
    """What workers must share: facts of this process, without CPU features where they may be
    ``mixed``.
    """
    facts = worker_facts()
    if mixed:
        facts.pop(CPU)
        facts.pop("processor")
    return facts


def _minor(python: str) -> str:
    return ".".join(python.split(".")[:2])


def _refuse(address: str, difference: str) -> None:
    if not difference:
        return
    advice = (
        "use machines of one kind, or --mixed, with which bytes are not promised"
        if CPU in difference
        else "install the same version on all workers"
    )
    raise EngineStoppedError(f"worker {address} {difference}; {advice}")
