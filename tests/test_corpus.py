"""What every reader reads soundly, and inputs that one did not answer once (`make fuzz`)."""

from __future__ import annotations

import pytest
from fuzz import CORPUS, READERS, seeds, tried


@pytest.mark.parametrize("reader", READERS)
def test_inputs_are_answered_or_refused(reader: str) -> None:
    for data in (b"", b"\0", b"\xff\xfe", *seeds(reader)):
        tried(reader, data)


def test_kept_inputs_belong_to_a_reader() -> None:
    kept = {path.name for path in CORPUS.iterdir()} if CORPUS.is_dir() else set()
    assert kept <= READERS.keys()
