"""`dqforge serve`: a page in the browser of this machine, until Ctrl-C."""

from __future__ import annotations

import asyncio
import signal
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError

if TYPE_CHECKING:
    from dqforge.reports.browser.server import Server


def serve(folder: Path, port: int, *, opening: bool) -> None:
    """Serve a design folder to a browser on this machine.

    Args:
        folder: Holds the design file, or will.
        port: Of the loopback address; 0: a free one.
        opening: Whether the page is opened in the browser.

    Raises:
        InputError: The folder is a file, or the port is taken.
    """
    from dqforge.reports.browser.server import Server

    if folder.is_file():
        raise InputError(
            f"{folder} is a file; give the folder of a design, {folder.parent} perhaps"
        )
    try:
        server = Server(folder, port)
    except OSError as error:
        reason = error.strerror or "it cannot be had"
        raise InputError(f"--port: {port}: {reason}; leave it out for a free one") from None
    sys.stdout.write(f"{folder / 'design.yaml'} in the browser: {server.address}\nCtrl-C ends it\n")
    sys.stdout.flush()
    if opening:
        webbrowser.open(server.address)
    asyncio.run(_until_ended(server))


async def _until_ended(server: Server) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        try:
            loop.add_signal_handler(number, ended.set)
        except NotImplementedError:  # Windows: Ctrl-C is an exception there
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(ended.set))
    await server.serve(ended)
