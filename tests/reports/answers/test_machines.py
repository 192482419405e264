"""The library as it is listed: what its files say, without any of them being loaded."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.reports.answers.machines import answer_machines


def test_the_list_says_what_the_drives_say() -> None:
    table = answer_machines(None).tables[0]
    assert [row[0] for row in table.rows] == catalogue.names()
    for key, name, about in table.rows[:3]:
        design = catalogue.load(key)
        assert (name, about) == (design.name, design.about)
    assert all(name and about for _, name, about in table.rows)


def test_one_drive_is_its_file() -> None:
    answer = answer_machines("abb-syrm-6k7")
    assert answer.notes == (catalogue.read_text("abb-syrm-6k7").decode().removesuffix("\n"),)
    with pytest.raises(InputError, match="did you mean abb-syrm-6k7"):
        answer_machines("abb-syrm-6k")


def test_a_list_needs_no_numbers() -> None:
    # Numerical libraries and the schema of designs take seconds to import.
    heavy = "numpy", "scipy", "dqforge.machines.design.catalogue", "dqforge.optimizer"
    program = (
        "import sys\nfrom dqforge.cli import main\n"
        "try:\n    main(['machines'])\nexcept SystemExit:\n    pass\n"
        f"sys.exit(' '.join(name for name in {heavy!r} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.stderr.strip() == ""
    assert "abb-syrm-6k7" in done.stdout
