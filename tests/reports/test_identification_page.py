"""The page of an identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench_files import bench_text, slow_noise, write_table

from dqforge.machines.bench.bench_reader import read_bench
from dqforge.optimizer.identification.flux_points import FluxTable
from dqforge.optimizer.identification.identify import identify
from dqforge.reports.answers.identify import answer_identify
from dqforge.reports.identification_page import identification_page, missing_points

RUN = """
- name: rows
  kind: constant-speed
  file: log.csv
  columns: {i_q: iq, i_d: id, u_q: uq, u_d: ud, speed: w}
  currents: measured
  voltage: measured
"""


def bench(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    speed = rng.uniform(-300.0, 300.0, 200)
    i_d, i_q = rng.uniform(-10.0, 0.0, 200), rng.uniform(-10.0, 10.0, 200)
    noise = slow_noise(rng, 200, 0.5, 0.05)
    omega = 4.0 * speed
    write_table(
        folder / "log.csv",
        {
            "id [A]": i_d,
            "iq [A]": i_q,
            "ud [V]": 0.1 * i_d - omega * 1e-3 * i_q + noise,
            "uq [V]": 0.1 * i_q + omega * (0.01 + 8e-4 * i_d) + noise,
            "w [rad/s]": speed,
        },
    )
    path = folder / "bench.yaml"
    machine = "pole_pairs: 4\nmax_current: 10 A"
    text = bench_text(RUN, machine, "{v_dc: 48 V, switching_frequency: 20 kHz}")
    path.write_text(text.replace("Machine on a bench", "'<b>Motor</b> & more'"))
    return path


def test_the_page_shows_what_was_found_and_nothing_else(tmp_path: Path) -> None:
    found = identify(read_bench(bench(tmp_path)))
    page = identification_page(found).decode()
    assert page == identification_page(found).decode()
    assert "<b>Motor" not in page
    assert "&lt;b&gt;Motor&lt;/b&gt; &amp; more" in page
    for title in ("Parameters", "Residuals", "Correlations", "Runs"):
        assert f"<h2>{title}</h2>" in page
    for parameter in found.parameters:
        assert parameter.label.split(" ")[0] in page
    assert found.bench.digest in page
    assert str(tmp_path) not in page


def test_it_is_written_where_files_are(tmp_path: Path) -> None:
    path = bench(tmp_path)
    for page in (True, False):
        files = answer_identify(path, page=page).files
        assert files is not None
        assert ("report.html" in files.contents) is page


def test_holes_of_a_grid() -> None:
    i_d, i_q = (axis.ravel() for axis in np.meshgrid([-20.0, -10.0, 0.0], [-5.0, 0.0, 5.0]))
    kept = np.arange(9) != 4

    def table(d: np.ndarray, q: np.ndarray) -> FluxTable:
        zero = np.zeros(d.size)
        count = np.ones(d.size, dtype=np.intp)
        return FluxTable(d, q, zero, zero, zero, zero, count, np.zeros((0, 2, d.size)))

    assert missing_points(table(i_d[kept], i_q[kept])).tolist() == [[-10.0, 0.0]]
    assert missing_points(table(i_d, i_q)).size == 0
    rng = np.random.default_rng(0)
    assert missing_points(table(rng.normal(size=40), rng.normal(size=40))).size == 0
