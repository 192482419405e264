"""Commands in a pseudo-terminal: what a person types, and what is seen."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

_PATIENCE_S, _NEXT_KEY_S = 60.0, 5.0
# Who leads a session gets the first terminal that it opens as its own, whose keys then reach it.
_PROGRAM = (
    "import os; os.close(os.open(os.ttyname(0), os.O_RDWR)); from dqforge import cli; cli.main()"
)

INTERRUPT, END = "\x03", "\x04"


class PseudoTerminal:
    """A command of dqforge whose input, output and errors are one terminal."""

    def __init__(
        self, folder: Path, words: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> None:
        import pty

        self._ours, theirs = pty.openpty()

        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *words],
            cwd=folder,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=os.environ | {"TERM": "dumb", "COLUMNS": "160"} | dict(environment or {}),
            start_new_session=True,
        )
        os.close(theirs)
        self.seen = ""

    def __enter__(self) -> PseudoTerminal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._ours)

    def answer(self, prompt: str, text: str) -> str:
        """Wait for a prompt, type a line; what was shown up to the prompt."""
        shown = self._until(prompt)
        os.write(self._ours, f"{text}\n".encode())
        return shown

    def press(self, prompt: str, key: str) -> str:
        """Wait for a prompt, press a key until something comes of it; what was shown up to the
        prompt.

        Ctrl-C in the very moment at which a question begins to wait is heard with the next key.
        """
        shown = self._until(prompt)
        while self._pending():
            self._more()
        before = self.seen
        for _ in range(round(_PATIENCE_S / _NEXT_KEY_S)):
            os.write(self._ours, key.encode())
            while self._pending(_NEXT_KEY_S) and self._more():
                if self.seen.removeprefix(before).replace("^C", "").strip():
                    return shown
        return shown

    def rest(self) -> tuple[str, int]:
        """What is shown until the command ends, and its exit code."""
        while self._more():
            pass
        shown, self.seen = self.seen, ""
        return shown, self._process.wait(_PATIENCE_S)

    def _until(self, prompt: str) -> str:
        while prompt not in self.seen:
            assert self._more(), f"ended before {prompt!r}: {self.seen}"
        shown, _, self.seen = self.seen.partition(prompt)
        return shown

    def _pending(self, seconds: float = 0.2) -> bool:
        """Whether more is shown within some seconds."""
        return bool(select.select([self._ours], [], [], seconds)[0])

    def _more(self) -> bool:
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            if not self._pending():
                continue
            try:
                data = os.read(self._ours, 65536)
            except OSError:  # the last process has let go of the terminal
                return False
            self.seen += data.decode("utf-8", "replace").replace("\r\n", "\n")
            return bool(data)
        raise AssertionError(f"nothing more is shown: {self.seen}")
