"""What campaigns keep: a line in `tests/corpus` for each case that failed once, and what a large
one found in docs/project/evidence.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

CORPUS = Path(__file__).parent / "corpus"
EVIDENCE = Path(__file__).parent.parent / "docs" / "project" / "evidence.md"
LARGE = 1000


@dataclass(frozen=True)
class Campaign:
    """Cases that a line makes again.

    Args:
        name: Of the file in the corpus.
        claim: First cell of its row in the table of evidence.
        shown_by: What runs it, for the second.
    """

    name: str
    claim: str
    shown_by: str

    def kept(self) -> list[str]:
        """Lines of all that failed once."""
        path = CORPUS / self.name
        return path.read_text(encoding="ascii").splitlines() if path.is_file() else []

    def ended(self, counts: Mapping[str, int], failed: Collection[str]) -> str:
        """Keep what failed, and the counts of a large campaign; says them."""
        if failed:
            CORPUS.mkdir(exist_ok=True)
            text = "".join(f"{line}\n" for line in sorted({*self.kept(), *failed}))
            (CORPUS / self.name).write_text(text, encoding="ascii")
        each = ", ".join(f"{name} {number}" for name, number in sorted(counts.items()))
        total = sum(counts.values())
        said = f"{total - len(failed):,} of {total:,} ({each})"
        if total >= LARGE:
            row = f"| {self.claim} | {said}: {self.shown_by} |"
            rows = EVIDENCE.read_text(encoding="utf-8").splitlines()
            rows = [row if old.startswith(f"| {self.claim} |") else old for old in rows]
            EVIDENCE.write_text("\n".join([*rows, *({row} - {*rows})]) + "\n", encoding="utf-8")
        return f"{said}\n"
