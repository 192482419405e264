"""What outputs depend on, as a file."""

from __future__ import annotations

import json

import numpy as np

from dqforge.optimizer.exploration.sensitivities import Sensitivities
from dqforge.reports.exploration.summary_files import sensitivity_file

FOUND = Sensitivities(
    "reference.torque_error",
    ("machine.resistance", "machine.inductance_q"),
    1000,
    np.array([np.nan, 0.578]),
    np.array([0.01, 0.5805]),
    0.0005,
)


def test_sensitivities_as_json() -> None:
    data = sensitivity_file("Yield", "ab" * 32, [FOUND, FOUND.designed(FOUND.first, FOUND.first)])
    plain = json.loads(data)
    assert (plain["command"], plain["design"], plain["rows_sha256"]) == (
        "explore",
        "Yield",
        "ab" * 32,
    )
    one, other = plain["sensitivities"]
    assert one == {
        "output": "reference.torque_error",
        "rows": 1000,
        "bias": 0.0005,
        "inputs": [
            {
                "input": "machine.resistance",
                "first": None,
                "squared_correlation": 0.01,
                "total": None,
            },
            {
                "input": "machine.inductance_q",
                "first": 0.578,
                "squared_correlation": 0.5805,
                "total": None,
            },
        ],
    }
    assert other["inputs"][1]["total"] == 0.578
    assert other["bias"] == 0.0
