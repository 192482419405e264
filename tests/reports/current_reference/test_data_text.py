"""What header and terminal say of a reference that the data of a flux map hold,
or that leaves them.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from drives import make_design
from one_sided import one_sided

from dqforge.machines.design.settings import FitSettings
from dqforge.optimizer.current_reference.solve import DataUse, solve_fit
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.reports.current_reference.capability import fit_tables
from dqforge.reports.current_reference.plain import data_lines, plain_data_use
from dqforge.reports.operating_points.map_tables import mtpa_tables


def test_nothing_is_said_where_the_data_cover_a_reference() -> None:
    assert data_lines(DataUse(), 10.0) == []


@pytest.mark.parametrize(
    ("use", "said"),
    [
        (DataUse(held=(0.0, 10.0)), "From zero torque on the currents are held by the data"),
        (DataUse(held=(2.5, 10.0)), "From 2.5 N m on the currents are held by the data"),
        (
            DataUse(extrapolated=(2.5, 5.0)),
            "From 2.5 N m to 5 N m the currents lie beyond the flux map",
        ),
    ],
)
def test_sentences_name_the_torques(use: DataUse, said: str) -> None:
    lines = data_lines(use, 10.0)
    assert lines[0].startswith(said)
    assert max(len(line) for line in lines) <= 110
    assert plain_data_use(use) == {"held_by_data_Nm": use.held, "extrapolated_Nm": use.extrapolated}


@pytest.mark.parametrize(
    ("extrapolate", "said"), [(False, "held by the data"), (True, "extrapolated")]
)
def test_tables_of_a_one_sided_map_say_it(extrapolate: bool, said: str) -> None:
    machine = one_sided("ends at i_d = 0", 0.5e-3, 0.25e-3, 0.0, extrapolate=extrapolate)
    design = replace(make_design(fit=FitSettings(form="polynomial")), machine=machine)
    found = solve_fit(design)
    notes = " ".join(fit_tables(design, found.fit, (), (), None, found.data)[0].notes)
    assert (
        f"From zero torque on the currents {'lie beyond' if extrapolate else 'are held'}" in notes
    )
    assert said in notes
    table = mtpa_tables(design, solve_curves(design))[0]
    assert ("the data" in table.rows[5]) != extrapolate
