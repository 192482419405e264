"""What a design file lacks is said at once, and pasted as it is said makes a design."""

from __future__ import annotations

import re
from itertools import combinations

import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError

LINES = {
    "name": "name: a motor",
    "machine.resistance": "  resistance: 2.35 Ohm",
    "machine.max_current": "  max_current: 12 A",
    "inverter.v_dc": "  v_dc: 300 V",
    "inverter.switching_frequency": "  switching_frequency: 10 kHz",
}
WHOLE = [
    "dqforge: 1",
    LINES["name"],
    "machine:",
    "  pole_pairs: 3",
    "  inductance_d: 1.61 mH",
    "  inductance_q: 1.74 mH",
    "  magnet_flux: 0.06 Wb",
    LINES["machine.resistance"],
    LINES["machine.max_current"],
    "inverter:",
    "  topology: three-wire",
    LINES["inverter.v_dc"],
    LINES["inverter.switching_frequency"],
    "export: {prefix: bench}",
]


def said_of(text: str) -> str:
    with pytest.raises(InputError) as refused:
        load_text(text.encode(), "d.yaml")
    return str(refused.value)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_everything_that_is_missing_is_said_in_one_line(count: int) -> None:
    load_text("\n".join(WHOLE).encode(), "d.yaml")
    for removed in combinations(LINES, count):
        gone = [LINES[key] for key in removed]
        said = said_of("\n".join(line for line in WHOLE if line not in gone))
        for key in removed:
            assert re.search(rf"\b{key.rpartition('.')[2]}\b", said), (key, said)
        for key in LINES.keys() - set(removed):
            assert not re.search(rf"\b{key.rpartition('.')[2]}\b", said.partition(": ")[2]), said


def test_a_path_alone_says_how_it_is_written() -> None:
    text = "\n".join(WHOLE).replace("machine:", "machine:\n  model: flux-map\n  flux_map: a/b.csv")
    assert "write {file: a/b.csv}" in said_of(text)
