"""How a process of dqforge ends: one line on stderr and an exit code, whatever went wrong,
and never a traceback.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress

from dqforge.machines.errors import DqforgeError
from dqforge.reports.command_line.refusals import tell
from dqforge.reports.operating_system import system
from dqforge.reports.operating_system.console_encoding import spell_out

# What the system says of files and disks, and not of connections or processes.
INTERRUPTED = 130
_OF_FILES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EMFILE)


def exit_code(command: Callable[[], object], locate: Callable[[DqforgeError], None]) -> int:
    """Run a command; what goes wrong becomes a line on stderr and an exit code.

    Args:
        command: What is run; its result is the exit code where it is a number.
        locate: Gives a refusal its place in a design.
    """
    import typer
    from typer.exceptions import TyperException

    _open_streams()
    spell_out()
    try:
        with warnings.catch_warnings():
            # Numerical trouble ends in a message; what libraries remark on
            # themselves is nobody's business.
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            code: object = command()
        sys.stdout.flush()
    except DqforgeError as error:
        code = _refused(error, locate)
    except TyperException as error:
        tell(_usage_line(error))
        code = 2
    except (typer.Abort, KeyboardInterrupt):
        tell("interrupted")
        code = INTERRUPTED
    except (BrokenPipeError, SystemExit) as error:
        left = isinstance(error, BrokenPipeError) or isinstance(error.__context__, BrokenPipeError)
        if not left:
            raise
        code = 0  # the reader of a pipe has left; there is nobody to tell
        _drop_output()
    except ImportError as error:
        from dqforge.reports.operating_system.packages import without_package

        missing = without_package(error)
        if missing is None:
            raise
        tell(str(missing))  # which no place in a design is to blame for
        code = missing.exit_code
    except OSError as error:
        code = 0 if _left_on_windows(error) else 1
        if code:
            tell(_system_line(error))
        _drop_output()
    except (ArithmeticError, RuntimeWarning, ValueError) as error:
        from dqforge.machines.design.numerical import refusal_of

        refusal = refusal_of(error)
        if refusal is None:
            raise
        code = _refused(refusal, locate)
    return code if isinstance(code, int) else 0


def _left_on_windows(error: OSError) -> bool:
    """Whether this is how Windows says that the reader of a pipe has left."""
    return system.WINDOWS and error.errno == errno.EINVAL and error.filename is None


def _refused(error: DqforgeError, locate: Callable[[DqforgeError], None]) -> int:
    locate(error)
    tell(str(error), error)
    return error.exit_code


def _usage_line(error: Exception) -> str:
    """One line for a wrong command line: what the parser says, and where help is."""
    context = getattr(error, "ctx", None)
    path = "dqforge" if context is None else context.command_path
    message = error.format_message() if hasattr(error, "format_message") else str(error)
    return f"{message.rstrip('.')}; see '{path} --help'"


def _open_streams() -> None:
    """Give closed standard streams somewhere to write, so that no file opened later takes their
    place.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            setattr(sys, name, os.fdopen(nowhere, "w", encoding="utf-8"))


def _drop_output() -> None:
    """Send what is left in the buffer of stdout nowhere: the interpreter would try, and fail,
    again at its end.
    """
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _system_line(error: OSError) -> str:
    """One line for what the system refused; a stdout that is to blame refuses
    one character more as well.
    """
    reason = error.strerror or str(error)
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return f"standard output cannot be written: {reason}"
    if error.filename is None and error.errno not in _OF_FILES:
        return f"the system refuses what the command needs: {reason}; give it again"
    named = f" {error.filename!r}" if error.filename is not None else ""
    return (
        f"the system refuses a file{named}: {reason}; is the disk, or the folder that TMPDIR "
        "names, full?"
    )
