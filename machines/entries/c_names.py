"""Names that may stand in generated code."""

from __future__ import annotations

import re
import unicodedata

from dqforge.machines.entries.header_names import taken_header
from dqforge.machines.entries.rules import EntryError
from dqforge.machines.wording import shown

MAX_PREFIX = 31  # C99 guarantees no more significant characters of an external name


_C_KEYWORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main
alignas alignof bool constexpr false nullptr static_assert thread_local true typeof typeof_unqual
"""


_CPP_KEYWORDS = """
and and_eq asm atomic_cancel atomic_commit atomic_noexcept bitand bitor catch char8_t char16_t char32_t class compl
concept consteval constinit const_cast co_await co_return co_yield decltype delete dynamic_cast explicit export friend
mutable namespace new noexcept not not_eq operator or or_eq private protected public reflexpr reinterpret_cast requires
static_cast synchronized template this throw try typeid typename using virtual wchar_t xor xor_eq std
"""


KEYWORDS = frozenset(_C_KEYWORDS.split()) | frozenset(_CPP_KEYWORDS.split())


def _free(prefix: str) -> str:
    """Prefix like the one that is taken, whose files shadow nothing."""
    for candidate in (f"{prefix[: MAX_PREFIX - 1]}1", f"my_{prefix}"[:MAX_PREFIX].rstrip("_")):
        if not taken_header(candidate):
            return candidate
    return "motor1"


def check_prefix(prefix: str) -> str:
    """Prefix of all names in the generated code, unchanged.

    Raises:
        EntryError: The prefix is no identifier in C and C++, or reserved there, or a header of its
            name would shadow one of the standard library or of a vendor.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", prefix, re.ASCII):
        # Letters with accents keep their base letter: Motör becomes Motor.
        plain = unicodedata.normalize("NFKD", prefix).encode("ascii", "ignore").decode()
        hint = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_0123456789")[:MAX_PREFIX].strip("_")
        write = f"; write e.g. {hint}" if hint and hint not in KEYWORDS else "; write e.g. motor1"
        raise EntryError(
            f"{shown(prefix)} is not an identifier in C: letters, digits and '_', a letter "
            f"first{write}"
        )
    if prefix.startswith("_") or prefix.endswith("_") or "__" in prefix:
        hint = re.sub(r"_+", "_", prefix).strip("_") or "motor1"
        raise EntryError(
            f"{shown(prefix)} leads to names that C and C++ reserve ('_' outside, '__'); write "
            f"e.g. {hint}"
        )
    if len(prefix) > MAX_PREFIX:
        raise EntryError(f"the prefix has {len(prefix)} characters; write at most {MAX_PREFIX}")
    if prefix in KEYWORDS:
        raise EntryError(f"{shown(prefix)} is a word of C or C++; write e.g. {prefix}1")
    if taken := taken_header(prefix):
        raise EntryError(
            f"{shown(prefix)} would write a file that shadows {taken}; write e.g. {_free(prefix)}"
        )
    return prefix
