"""What `dqforge verify` says of a folder that it computed again."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.reports.output.recomputation import BOUND, Recomputation
from dqforge.reports.run_folder import INPUT_DESIGN

_NAMED = 4


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def recomputation_text(found: Recomputation) -> str:
    """What was not computed again, and where last digits differ, where there is such; then a line
    on what was computed again.
    """
    lines = []
    if found.listed:
        lines.append(
            "not computed again, and held by the SHA-256 of the manifest alone: "
            f"{_names(found.listed)}"
        )
    if found.foreign:
        lines.append(f"not written by dqforge and not looked at: {_names(found.foreign)}")
    lines += [
        f"differs by the last digits of another library or processor, within {BOUND}: {each}"
        for each in found.digits
    ]
    if found.stale:
        lines.append(f"of the design in another state than the headers: {_names(found.stale)}")
    if found.line_ends:
        lines.append(f"with other line endings than dqforge writes: {_names(found.line_ends)}")
    count = found.tally
    counts = (
        (count.macros, "macros"),
        (count.literals, "literals in code and tables"),
        (count.figures, "figures in comments"),
        (count.checksums, "checksums"),
        (count.vectors, "test vectors"),
        (count.entries, "entries of result.json"),
    )
    if count.files:
        held = ", ".join(f"{number} {what}" for number, what in counts if number)
        equal = "hold" if found.digits else "equal"
        lines.append(
            f"{count.files} files {equal} what {INPUT_DESIGN} (SHA-256 {found.digest[:12]}) gives "
            f"when it is computed again{f': {held}' if held else ''}"
        )
    return "\n".join(lines)
