"""Plain data, tables for notebooks and labelled arrays of results."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dqforge
from dqforge.reports.session.result import as_lists, html_table

MACHINE = dqforge.LinearMachine(
    pole_pairs=4, r_s=0.02, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=300.0
)
TORQUE, OMEGA_M = np.array([10.0, 60.0, 150.0]), np.array([100.0, 900.0])


def points() -> dqforge.OperatingPoints:
    return dqforge.operating_points(MACHINE, TORQUE[:, None], OMEGA_M[None, :], v_dc=400.0)


def test_plain_data_goes_into_json_and_keeps_every_digit() -> None:
    found = points()
    plain = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    np.testing.assert_array_equal(plain["points"]["i_d_A"], found.i_d)
    assert plain["points"]["reached"] == found.reached.tolist()
    at_rest = dqforge.operating_points(MACHINE, [10.0], 0.0, v_dc=400.0)
    assert at_rest.to_dict()["efficiency"] == [None]


def test_what_json_cannot_hold_is_none() -> None:
    given = {
        "a": np.array([1.0, np.nan]),
        "b": (np.float64(2.0), np.inf),
        "c": {"d": np.int64(3)},
        "e": None,
    }
    assert as_lists(given) == {"a": [1.0, None], "b": [2.0, None], "c": {"d": 3}, "e": None}


def test_tables_name_units_and_escape_what_the_user_wrote() -> None:
    plain = {
        "name": "<script>",
        "drive": {"r_s_Ohm": 0.5, "i_d_A": np.array([1.0, 2.5])},
        "rows": [{"a": 1}],
        "q": None,
    }
    table = html_table("A & B", plain)
    assert "<script>" not in table
    assert "&lt;script&gt;" in table
    assert "<caption>A &amp; B</caption>" in table
    assert "<td>drive.r_s</td><td>0.5</td><td>\N{GREEK CAPITAL LETTER OMEGA}</td>" in table
    assert "<td>drive.i_d</td><td>2 values, 1 to 2.5</td><td>A</td>" in table
    assert "<td>rows</td><td>1 entries</td>" in table


def test_long_tables_end() -> None:
    table = html_table("many", {f"k{index}": index for index in range(100)})
    assert table.count("<tr>") == 41
    assert "60 more" in table


def test_every_result_shows_itself() -> None:
    chart = dqforge.operating_map(MACHINE, 3, 4, v_dc=400.0)
    for result in (points(), chart, dqforge.characteristics(MACHINE, v_dc=400.0)):
        shown = result._repr_html_()
        assert shown.startswith(f"<table><caption>{type(result).__name__}</caption><tr>")
        assert "rad/s" in shown


def test_points_are_printed_as_a_table() -> None:
    found = dqforge.operating_points(MACHINE, [10.0, 60.0], 100.0, v_dc=400.0)
    title, headings, *rows = repr(found).splitlines()
    assert title == "OperatingPoints"
    assert headings.split()[:6] == ["torque", "N", "m", "speed", "rad/s", "i_d"]
    assert len(rows) == 2
    for k, row in enumerate(rows):
        cells = row.split()
        assert float(cells[0]) == (10.0, 60.0)[k]
        assert float(cells[2]) == pytest.approx(found.i_d[k], rel=1e-4)
        assert float(cells[3]) == pytest.approx(found.i_q[k], rel=1e-4)
        assert float(cells[5]) == pytest.approx(found.copper_loss[k], rel=1e-4)
    many = dqforge.operating_points(MACHINE, np.linspace(0.0, 100.0, 30), 100.0, v_dc=400.0)
    assert len(repr(many).splitlines()) == 10
    assert repr(many).endswith("23 more: to_dict() has them")


def test_losses_are_printed_as_a_table() -> None:
    design = dqforge.load_design("paper000-ipmsm-100kw")
    names: dict[str, Any] = {
        "strategies": ["mtpa", "id0"],
        "modulations": ["svpwm", "ddt-gdpwm"],
    }
    found = dqforge.losses(design, [130.0], [300.0], **names)
    rows = [line.split() for line in repr(found).splitlines()[2:]]
    assert len(rows) == 4
    (best,) = [row for row in rows if row[-1] == "best"]
    assert tuple(best[2:4]) == found.best[0]
    assert float(best[4]) == pytest.approx(np.nanmin(found.total), rel=1e-3)
    assert [(point.torque, point.omega_m) for point in found.points] == [(130.0, 300.0)]
    chart = repr(dqforge.loss_map(design, 2, 3, **names)).splitlines()
    assert chart[1].split()[:2] == ["strategy", "modulator"]
    assert len(chart) == 6


def test_points_have_a_figure() -> None:
    (axes,) = points().figure().axes
    lines = [line for line in axes.lines if np.size(line.get_xdata()) == TORQUE.size]
    assert [line.get_label() for line in lines] == ["954.93 rpm", "8594.4 rpm"]
    drawn = np.asarray(lines[0].get_ydata(), dtype=float)
    np.testing.assert_allclose(drawn, np.asarray(points().i_q[:, 0], dtype=float))


def test_messages_of_changes_name_no_option_of_the_command_line() -> None:
    given: list[Any] = [
        {"machine.max_currnt": 8.0},
        {"machine.max_current": "8 foo"},
        {"fit..degree": 3},
        {"nowhere": 3},
    ]
    for changes in given:
        with pytest.raises(dqforge.InputError, match=r"^changes: ") as error:
            dqforge.load_design("abb-ipmsm-2k2", changes)
        assert "--set" not in str(error.value)


def test_a_printed_design_names_the_keys_of_its_constants() -> None:
    shown = repr(dqforge.load_design("paper000-ipmsm-100kw"))
    assert "r_s: resistance 2 mOhm (phase)" in shown
    assert "pole_pairs: poles 8" in shown
    bench = dqforge.make_design(MACHINE, v_dc=400.0, f_sw=1e4)
    assert "psi_pm: magnet_flux 0.1049 Wb (peak)" in repr(bench)


def test_labelled_arrays_need_xarray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(
        dqforge.InputError, match="needs xarray, which is not installed; pip install xarray"
    ):
        points().to_xarray()


def test_labelled_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """What xarray is given, recorded by a module in its place: dimensions,
    values and units of every array.
    """

    def dataset(
        values: dict[str, Any], *, coords: dict[str, Any], attrs: dict[str, Any]
    ) -> SimpleNamespace:
        for names, array, about in values.values():
            assert array.shape == tuple(len(coords[name][1]) for name in names)
            assert set(about) == {"units"}
        return SimpleNamespace(values=values, coords=coords, attrs=attrs)

    monkeypatch.setitem(sys.modules, "xarray", SimpleNamespace(Dataset=dataset))
    found = points()
    given = found.to_xarray()
    np.testing.assert_array_equal(given.coords["torque"][1], TORQUE)
    np.testing.assert_array_equal(given.coords["omega_m"][1], OMEGA_M)
    names, array, about = given.values["i_d"]
    assert (names, about) == (("torque", "omega_m"), {"units": "A"})
    np.testing.assert_array_equal(array, found.i_d)
    assert given.attrs["v_dc_V"] == 400.0
    chart = dqforge.operating_map(MACHINE, 3, 4, v_dc=400.0)
    np.testing.assert_array_equal(chart.to_xarray().values["efficiency"][1], chart.efficiency)
    with pytest.raises(dqforge.InputError, match="needs a grid"):
        dqforge.operating_points(MACHINE, [1.0, 2.0], 10.0, v_dc=400.0).to_xarray()


def test_real_xarray_takes_it() -> None:
    xarray = pytest.importorskip("xarray")
    given = points().to_xarray()
    assert isinstance(given, xarray.Dataset)
    assert float(given.i_d.sel(torque=60.0, omega_m=100.0)) == points().i_d[1, 0]


def test_figures_go_into_files(tmp_path: Any) -> None:
    chart = dqforge.operating_map(MACHINE, 6, 8, v_dc=400.0)
    chart.plot(str(tmp_path / "map.svg"))
    assert b"<svg" in (tmp_path / "map.svg").read_bytes()[:400]
    with pytest.raises(dqforge.InputError, match=r"map\.gif"):
        chart.plot(tmp_path / "map.gif")
