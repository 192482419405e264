"""A page in a headless browser, as a person has it: a pointer, keys, a finger, downloads."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tornado.websocket import WebSocketClientConnection, websocket_connect

_PATIENCE_S = 180.0


def chromium() -> str:
    """A headless browser, or a skip that says how to get one; in CI it must be there."""
    program = shutil.which("chromium")
    if program is None:
        message = "no browser: install the Debian package chromium"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return program


class Tab:
    """A page that is open."""

    def __init__(self, loop: asyncio.AbstractEventLoop, socket: WebSocketClientConnection) -> None:
        self._loop, self._socket, self._number = loop, socket, 0
        self.complaints: list[str] = []

    def call(self, method: str, **parameters: Any) -> Any:
        """What the browser answers to a command of its protocol."""
        self._number += 1
        command = {"id": self._number, "method": method, "params": parameters}
        return self._loop.run_until_complete(self._answer(command))

    async def _answer(self, command: dict[str, Any]) -> Any:
        await self._socket.write_message(json.dumps(command))
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), _PATIENCE_S)
            assert text is not None, "the browser went away"
            told = json.loads(text)
            if told.get("method") in {"Log.entryAdded", "Runtime.exceptionThrown"}:
                self.complaints.append(json.dumps(told["params"]))
            if told.get("id") == command["id"]:
                assert "error" not in told, told
                return told["result"]

    def value(self, expression: str) -> Any:
        """What an expression in the page gives."""
        found = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def show(self, element: str) -> None:
        """Scroll to an element, which may be folded."""
        self.value(
            f"(() => {{ const found = {element};"
            "for (let part = found; part; part = part.parentElement)"
            "  if (part.localName === 'details') part.open = true;"
            "found.scrollIntoView({block: 'center', behavior: 'instant'}); })()"
        )
        self.settle()

    def settle(self) -> None:
        """Wait until what was asked for has been drawn, and events of it have been told."""
        self.value("new Promise((done) => requestAnimationFrame(() => setTimeout(done, 50)))")

    def move(self, x: float, y: float) -> None:
        """Put the pointer somewhere in the window."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def click(self, x: float, y: float) -> None:
        """Press and let go the left button."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def tap(self, x: float, y: float) -> None:
        """Touch with one finger."""
        self.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def press(self, key: str) -> None:
        """Press a key that has a name, such as ArrowLeft."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)


@contextmanager
def open_page(page: Path, folder: Path, width: int = 1280, height: int = 900) -> Iterator[Tab]:
    """A page in a window; ``folder`` takes the browser's own files and downloads."""
    profile = folder / "profile"
    command = [chromium(), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"]
    command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    command += ["--remote-debugging-port=0", f"--user-data-dir={profile}", "about:blank"]
    command += [f"--window-size={width},{height}", "--hide-scrollbars"]
    loop = asyncio.new_event_loop()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as browser:
        try:
            socket = loop.run_until_complete(_connected(_address(profile)))
            tab = Tab(loop, socket)
            for part in ("Page", "Runtime", "Log"):
                tab.call(f"{part}.enable")
            tab.call(
                "Emulation.setDeviceMetricsOverride",
                width=width,
                height=height,
                deviceScaleFactor=1,
                mobile=False,
            )
            tab.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
            tab.call("Page.navigate", url=page.as_uri())
            there = f"location.href === {json.dumps(page.as_uri())} && document.readyState"
            _until(lambda: tab.value(there) == "complete")
            tab.settle()
            yield tab
        finally:
            browser.terminate()
            browser.wait(_PATIENCE_S)
            loop.close()


def _address(profile: Path) -> str:
    port = profile / "DevToolsActivePort"
    _until(lambda: port.is_file() and "\n" in port.read_text(encoding="utf-8"))
    number = port.read_text(encoding="utf-8").split("\n")[0]
    with urllib.request.urlopen(f"http://127.0.0.1:{number}/json", timeout=_PATIENCE_S) as answer:
        tabs = json.load(answer)
    return str(next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page"))


async def _connected(address: str) -> WebSocketClientConnection:
    return await websocket_connect(address, max_message_size=1 << 28)


def _until(done: Any) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not done():
        assert time.monotonic() < end, "the browser did not come up"
        time.sleep(0.05)


def until_there(path: Path) -> bytes:
    """The content of a file that the browser is writing."""
    _until(lambda: path.is_file() and path.stat().st_size > 0)
    return path.read_bytes()
