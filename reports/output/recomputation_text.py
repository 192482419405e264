"""What `dqforge verify` says of a folder that it computed again."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.reports.output.recomputation import Recomputation
from dqforge.reports.run_folder import INPUT_DESIGN

_NAMED = 4


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def recomputation_text(found: Recomputation) -> str:
    """A line on what was computed again, and one each on what was not, where there is such."""
    count = found.tally
    counts = (
        (count.macros, "macros"),
        (count.literals, "literals in code and tables"),
        (count.figures, "figures in comments"),
        (count.checksums, "checksums"),
        (count.vectors, "test vectors"),
        (count.entries, "entries of result.json"),
    )
    parts = [", ".join(f"{number} {what}" for number, what in counts if number)]
    lines = [
        (
            f"{count.files} files equal what {INPUT_DESIGN} (SHA-256 {found.digest[:12]}) gives "
            "when it is computed again: "
        )
        + parts[0]
    ]
    if found.listed:
        lines.append(
            "as they were written, by their SHA-256, and not computed again: "
            f"{_names(found.listed)}"
        )
    if found.line_ends:
        lines.append(f"with other line endings than dqforge writes: {_names(found.line_ends)}")
    if found.foreign:
        lines.append(f"not written by dqforge and not looked at: {_names(found.foreign)}")
    return "\n".join(lines)
