"""Text on streams that do not know every character: signs of the field are spelled out.

A pipe on Windows, or a terminal of the C locale, takes no psi and no degree; what is printed there
is ``psi`` and ``deg``, and a question mark for what has no spelling. Files are always UTF-8.
"""

from __future__ import annotations

import codecs
import io
import sys

_HANDLER = "dqforge-spelled"

_SPELLINGS = {
    **dict(zip("°²³·¹⁻→√⋅−…×≤≥±–—", (
        "deg", "^2", "^3", "*", "^1", "^-", "->", "sqrt", "*", "-", "...", "x", "<=", ">=", "+-",
        "-", "-",
    ), strict=True)),
    **dict(zip("αβγδεζηθϑικλξπρσςτφϕχψωΔΘΛΠΣΦΨΩΩ", (
        "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "theta", "iota",
        "kappa", "lambda", "xi", "pi", "rho", "sigma", "sigma", "tau", "phi", "phi", "chi", "psi",
        "omega", "Delta", "Theta", "Lambda", "Pi", "Sigma", "Phi", "Psi", "Ohm", "Ohm",
    ), strict=True)),
    "µ": "u",
    "μ": "u",
}  # fmt: skip


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    sign = error.object[error.start]
    if "\udc80" <= sign <= "\udcff":  # a byte of a file's name that is no text
        return bytes((ord(sign) - 0xDC00,)), error.start + 1
    return _SPELLINGS.get(sign, "?"), error.start + 1


def spell_out() -> None:
    """Have stdout and stderr spell out what they cannot show; a way that somebody chose by
    ``PYTHONIOENCODING`` stays.
    """
    codecs.register_error(_HANDLER, _spelled)
    for stream in (sys.stdout, sys.stderr):
        usual = ("strict", "surrogateescape", "backslashreplace")
        if isinstance(stream, io.TextIOWrapper) and stream.errors in usual:
            stream.reconfigure(errors=_HANDLER)
