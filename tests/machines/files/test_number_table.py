"""Text tables against the numbers they were written from, another reader,
and files made by others.
"""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable, read_table

ROWS = np.array([[0.0, 1.5, -2.25e-3], [0.5, -1.5, 4.0], [1.0, 0.125, 1e6]])


def read(text: str, encoding: str = "utf-8") -> TextTable:
    return read_table(text.encode(encoding), "scope.csv")


def written(rows: FloatArray, delimiter: str, decimal: str = ".") -> str:
    return "\n".join(
        delimiter.join(f"{value!r}".replace(".", decimal) for value in row) for row in rows.tolist()
    )


@pytest.mark.parametrize("header", ["", "t{}a{}b\n", "made by hand\n\nt [s]{}a [A]{}b [mWb]\n"])
@pytest.mark.parametrize(
    ("delimiter", "decimal"),
    [
        (",", "."),
        (";", "."),
        (";", ","),
        ("\t", "."),
        ("\t", ","),
        ("|", ","),
        (" ", "."),
        ("    ", ","),
        (", ", "."),
    ],
)
def test_finds_out_delimiter_and_decimal_sign(delimiter: str, decimal: str, header: str) -> None:
    table = read(header.replace("{}", delimiter) + written(ROWS, delimiter, decimal))
    np.testing.assert_array_equal(table.values, ROWS)
    assert table.names == (("t", "a", "b") if header else ("column 1", "column 2", "column 3"))
    assert table.units == (("s", "A", "mWb") if "[" in header else ("", "", ""))
    assert table.lines.tolist() == [n + header.count("\n") for n in (1, 2, 3)]
    assert table.preamble == (("made by hand",) if "[" in header else ())


def test_reads_back_random_tables_in_all_dialects() -> None:
    generator = np.random.default_rng(1)
    for trial in range(300):
        delimiter, decimal = [
            (",", "."),
            (";", ","),
            (";", "."),
            ("\t", ","),
            ("|", "."),
            ("  ", ","),
            (" ", "."),
        ][trial % 7]
        rows = generator.normal(size=(generator.integers(2, 40), generator.integers(2, 7)))
        rows *= 10.0 ** generator.integers(-8, 8)
        if generator.random() < 0.3:
            rows = np.round(rows)
        end = delimiter.strip() if generator.random() < 0.3 else ""
        text = "\n".join(line + end for line in written(rows, delimiter, decimal).split("\n"))
        encoding = ("utf-8", "utf-8-sig", "utf-16", "latin-1")[trial % 4]
        newline = ("\n", "\r\n", "\r")[trial % 3]
        table = read((text + "\n\n").replace("\n", newline), encoding)
        np.testing.assert_array_equal(table.values, rows, err_msg=text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("u_V\n1,5\n2,5\n", [[1.5], [2.5]]),
        ("t_s,u_V\n1,5\n2,5\n", [[1.0, 5.0], [2.0, 5.0]]),
        ("1,5\n2,7\n", [[1.0, 5.0], [2.0, 7.0]]),
        ("1,5\n2\n3,25\n", [[1.5], [2.0], [3.25]]),
        ("1,5\n2,05\n", [[1.5], [2.05]]),
        ("1,5\n2,-5\n", [[1.0, 5.0], [2.0, -5.0]]),
        ("a\n1,5E-3\n2,25E+1\n", [[1.5e-3], [22.5]]),
        ('"a","b"\n"1,5","2,5"\n"3","4,5"\n', [[1.5, 2.5], [3.0, 4.5]]),
    ],
)
def test_a_lone_comma_is_explained_by_the_whole_file(
    text: str, expected: list[list[float]]
) -> None:
    assert read(text).values.tolist() == expected


@pytest.mark.parametrize(
    ("header", "names", "units"),
    [
        ("id [A],psi_d (mVs),ch1_V", ("id", "psi_d", "ch1"), ("A", "mVs", "V")),
        ("id_A,psi_d_Vs,t_s", ("id", "psi_d", "t"), ("A", "Vs", "s")),
        ('"Time, s","Flux linkage [Wb]",x', ("Time", "Flux linkage", "x"), ("s", "Wb", "")),
        ("Time (s),V(out),I(R1)", ("Time", "V(out)", "I(R1)"), ("s", "", "")),
        ("t / s,i_d/A,n in 1/min", ("t", "i_d", "n"), ("s", "A", "1/min")),
        ("psi_d,psi_q,theta_e_deg", ("psi_d", "psi_q", "theta_e"), ("", "", "deg")),
        ("I_A,I_B,I_C", ("I_A", "I_B", "I_C"), ("", "", "")),
        ("U_U [V],U_V [V],U_W [V]", ("U_U", "U_V", "U_W"), ("V", "V", "V")),
        ("i_d,i_q,psi_d\nA,A,Vs", ("i_d", "i_q", "psi_d"), ("A", "A", "Vs")),
        ("x,y,z\n(s),(V),-", ("x", "y", "z"), ("s", "V", "")),
        ("[s],[V],[V]", ("column 1", "column 2", "column 3"), ("s", "V", "V")),
        ("# x,y,z", ("x", "y", "z"), ("", "", "")),
        ("Motor,IPM\nRecord Length,2500\nt,,b", ("t", "column 2", "b"), ("", "", "")),
        ("x;y_mV;z", ("x", "y", "z"), ("", "mV", "")),
        ("sep=,\nx,y,z", ("x", "y", "z"), ("", "", "")),
    ],
)
def test_reads_names_and_units(header: str, names: tuple[str, ...], units: tuple[str, ...]) -> None:
    table = read(f"{header}\n{written(ROWS, ',')}\n")
    assert table.names == names
    assert table.units == units
    np.testing.assert_array_equal(table.values, ROWS)


def test_blanks_part_header_and_units() -> None:
    table = read("  i_d [A]   psi d(mVs)\n  1.0   2.0\n -1.0  -2.0\n".replace("psi d", "psi_d"))
    assert (table.names, table.units) == (("i_d", "psi_d"), ("A", "mVs"))
    table = read("t u\ns V\n1 2\n3 4\n")
    assert (table.names, table.units) == (("t", "u"), ("s", "V"))


def test_comments_may_hold_the_header_and_stand_among_the_rows() -> None:
    table = read("# made by a tool\n% t_s, u_V\n1 2\n# in between\n3 4\n\n# end\n")
    assert (table.names, table.units, table.preamble) == (
        ("t", "u"),
        ("s", "V"),
        ("# made by a tool",),
    )
    assert table.values.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert table.lines.tolist() == [3, 5]
    assert read("t,u\n# a remark\n1,2\n3,4\n").names == ("t", "u")


def test_what_spreadsheets_leave_behind_is_no_column_and_no_row() -> None:
    table = read("a;b;\r\n1,5;2;\r\n3;4,5;\r\n;;\r\n;;\r\n\r\n")
    assert (table.names, table.values.tolist()) == (("a", "b"), [[1.5, 2.0], [3.0, 4.5]])
    table = read("| a | b |\n|---|---|\n| 1 | 2 |\n| 3 | 4 |\n")
    assert (table.names, table.lines.tolist()) == (("a", "b"), [3, 4])


def test_empty_and_nan_cells_are_nan() -> None:
    expected = [
        [1.0, math.nan, 3.0],
        [math.nan, 2.0, math.nan],
        [4.0, 5.0, math.nan],
        [7.0, 8.0, 9.0],
    ]
    for cells in ("1,,3\nNaN,2,nan\n4,5, \n7,8,9\n", "1;;3,0\n;2;-nan\n4;5;\n7;8;9,0\n"):
        np.testing.assert_array_equal(read(cells).values, expected)


def test_exponents_of_engineers() -> None:
    assert read("1.0D+00,1.2E-3\n-2.5d2,.5e1\n").values.tolist() == [[1.0, 1.2e-3], [-250.0, 5.0]]
    assert read("a;b\n1,2E-3;+1\n-1,5D2;7\n").values.tolist() == [[1.2e-3, 1.0], [-150.0, 7.0]]


def test_encodings_of_units() -> None:
    text = "t [µs];T [°C]\n1,5;2\n3;4\n"
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "latin-1"):
        assert read(text, encoding).units == ("µs", "°C")
    assert read_table(b"\xfe\xff" + text.encode("utf-16-be"), "x").units == ("µs", "°C")


@pytest.mark.parametrize("state", ["OK", "2024-01-05 12:00", "05.01.2024", "n/a"])
def test_columns_of_text_are_left_out(state: str) -> None:
    table = read(f"a;state;b\n1,5;{state};2\n3;{state};4\n5;{state};6\n")
    assert table.names == ("a", "b")
    assert table.values.tolist() == [[1.5, 2.0], [3.0, 4.0], [5.0, 6.0]]
    table = read("a,b,note\n1,2,start\n3,4,\n5,6,\n")
    assert (table.names, table.lines.tolist(), table.preamble) == (
        ("a", "b"),
        [2, 3, 4],
        ("start",),
    )


SCOPES = {
    "tektronix": (
        (
            "Model,TDS2012\nFirmware,1.2\n\nHorizontal Units,s\nVertical Units,mV\n"
            "Record Length,3\n\nTIME,CH1\n"
        ),
        ("TIME", "CH1"),
        ("s", "mV"),
    ),
    "rigol": (
        "X,CH1,Start,Increment\nSequence,Volt,-3.00e-03,5.00e-06\n",
        ("X", "CH1"),
        ("Sequence", "Volt"),
    ),
    "lecroy": (
        "LECROY,40037,Waveform\nSegments,1,SegmentSize,3\nTime,Ampl\n",
        ("Time", "Ampl"),
        ("", ""),
    ),
}


@pytest.mark.parametrize("scope", SCOPES)
def test_headers_of_oscilloscopes(scope: str) -> None:
    head, names, units = SCOPES[scope]
    end = ",," if scope == "rigol" else ""
    table = read(head + "".join(f"{t},{u}{end}\n" for t, u in ((0.0, 1.5), (0.1, 2.5), (0.2, 3.5))))
    assert (table.names, table.units) == (names, units)
    assert table.values.tolist() == [[0.0, 1.5], [0.1, 2.5], [0.2, 3.5]]


FAULTS: dict[str, tuple[bytes, int | None, str]] = {
    "empty": (b"", 1, "empty"),
    "blank": (b"\xef\xbb\xbf \r\n\r\n", 1, "empty"),
    "prose": (b"hello\nworld in 2024\n", 1, "no line holds a row of numbers"),
    "header only": (b"a,b\nA,V\n", 1, "no line holds a row of numbers"),
    "one row": (b"a,b\n1,2\n", 2, "single row"),
    "binary": (b"a,b\n1,2\n\x89PNG\x00\x01\n", 3, "binary"),
    "damaged utf-16": (b"\xff\xfea\x00,", None, "UTF-16"),
    "large": (bytes(256_000_001), None, "256 MB"),
    "short row": (
        b"a,b,c\n1,2,3\n4,5\n6,7,8\n",
        3,
        "this line has 2 columns, the rows have 3: '4,5'",
    ),
    "short first row": (
        b"a,b,c\n1,2\n4,5,6\n6,7,8\n",
        2,
        "this line has 2 columns, the rows have 3",
    ),
    "long row": (b"a;b\n1,5;2\n\n4;5;6\n6;7\n", 4, "this line has 3 columns, the rows have 2"),
    "cut off": (b"1 2 3\n4 5 6\n7 8", 3, "this line has 2 columns"),
    "footer": (
        b"a,b\n1,2\n3,4\nend of data\n",
        4,
        "this line has 1 column, the rows have 2: 'end of data'",
    ),
    "text": (b"a,b_V,c\n1,2,3\n4,x7,5\n6,7,8\n", 3, "'x7' in column 'b' is not a number"),
    "text in the first row": (b"a,b\n1,oops\n4,5\n6,7\n", 2, "'oops' in column 'b'"),
    "text at the first place": (b"a,b,c\noops,2,3\n4,5,6\n6,7,8\n", 2, "'oops' in column 'a'"),
    "text without header": (b"1;2\n3;4\nx;5,5\n6;7\n", 3, "'x' in column 1 is not a number"),
    "second header": (b"t,u\n1,2\n3,4\nt,u\n5,6\n", 4, "'t' in column 't'"),
    "infinite": (b"a,b\n1,2\n2,inf\n3,4\n", 3, "'inf' in column 'b'"),
    "overflow": (b"a,b\n1,2\n2,1e999\n3,4\n", 3, "'1e999' in column 'b'"),
    "python number": (b"a,b\n1,2\n1_0,3\n3,4\n", 3, "'1_0' in column 'a'"),
    "thousands points": (
        b"a;b\n1.234,5;2,5\n1.234,5;2,5\n",
        2,
        "'1.234,5' in column 1 is not a number here",
    ),
    "thousands in all": (
        b"a;b\n1.234,56;2.345,67\n1.234,56;2.345,67\n",
        2,
        "no thousands separators",
    ),
    "thousands in one": (b"a;b\n1,5;2,5\n2,5;3,5\n1.234;2,5\n", 4, "'1.234' in column 'a'"),
    "thousands in the first": (b"a;b\n1.234;2,5\n1,5;2,5\n2,5;3,5\n", 2, "'1.234' in column 'a'"),
    "english thousands": (b"a;b\n1.5;2.5\n1,234.5;2.5\n2.5;3.5\n", 3, "'1,234.5' in column 'a'"),
    "blank thousands": (b"a;b\n1,5;2,5\n1 234,5;2,5\n2,5;3,5\n", 3, "'1 234,5' in column 'a'"),
    "thousands, one column": (
        b"a\n1.234,56\n2.345,67\n",
        2,
        "commas seem to part cells and to stand before decimals",
    ),
    "two decimal signs": (b"a;b\n1,5;2.5\n2,5;3.5\n3,5;4.5\n", 2, "one kind of decimal sign"),
    "commas for all": (b"id,iq\n1,5,2,5\n1,5,3,5\n", 2, "4 cells below a header of 2"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named_with_their_line(fault: str) -> None:
    content, line, message = FAULTS[fault]
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_table(content, "scope.csv")
    assert (caught.value.source, caught.value.line) == ("scope.csv", line)
    assert "\n" not in str(caught.value)


def test_faults_behind_many_rows_are_found() -> None:
    rows = "1.5,2.5,3\n" * 50_000
    with pytest.raises(InputError, match="'x' in column 'b'") as caught:
        read(f"a,b,c\n{rows}1,x,2\n{rows}4,5\n")
    assert caught.value.line == 50_002
    with pytest.raises(InputError, match="this line has 2 columns") as caught:
        read(f"a,b,c\n{rows}4,5\n{rows}1,x,2\n")
    assert caught.value.line == 50_002


@pytest.mark.slow
def test_large_tables_are_read_in_blocks_without_looking_at_cells(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = np.random.default_rng(2).normal(size=(200_000, 4))
    stream = io.StringIO()
    np.savetxt(stream, rows, fmt="%.17g", delimiter=";", header="t_s;u1_V;u2_V;u3_V", comments="")
    monkeypatch.setattr("dqforge.machines.files.text_table._cell_by_cell", None)
    table = read(stream.getvalue().replace(".", ","))
    np.testing.assert_array_equal(table.values, rows)
    assert table.lines[-1] == 200_001


# Long runs of blanks and marks made naive patterns take minutes.
@pytest.mark.parametrize("filler", [" ", "_", "1", "(", "#", "-", "\t"])
@pytest.mark.parametrize("delimiter", [",", "\t", " "])
def test_long_cells_are_no_burden(delimiter: str, filler: str) -> None:
    rows = f"1{delimiter}2\n3{delimiter}4\n"
    table = read(f"a{filler * 100_000}]{delimiter}b\n{rows}")
    assert table.values.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def by_another_reader(path: Path) -> tuple[list[str], FloatArray]:
    with path.open(newline="") as stream:
        head, *rows = csv.reader(stream)
    return head, np.array(rows, dtype=np.float64)


PLAIN_FILES = {
    "bemf/femag_test002_noload_3ph_p4_50rps.csv": ("deg", "Vs", "Vs", "Vs", "V", "V", "V"),
    "bemf/thor_noload_phase_flux.csv": ("deg", "Vs", "Vs", "Vs"),
    "bemf/vdyno_trampa6340_0250rpm1_dec10.csv": ("s", "V", "V", "V"),
    "bemf/vdyno_trampa6340_0500rpm1_dec10.csv": ("s", "V", "V", "V"),
    "fluxmaps/baldor_ecs101m0h7ef4_400rpm_measured.csv": ("A", "A", "Vs", "Vs", "V"),
    "fluxmaps/femag_pm270l8_psidq_losses_50rps.csv": ("A", "A", "Vs", "Vs", "Nm", *["W"] * 7),
    "fluxmaps/femag_test_11x11_p6.csv": ("A", "A", "Vs", "Vs"),
    "fluxmaps/thor_syre_MPFPA.csv": ("A", "A", "Vs", "Vs", "Nm", "Nm"),
    "fluxmaps/thor_syre_MTPA.csv": ("A", "A", "Vs", "Vs", "Nm", "Nm"),
    "fluxmaps/thor_syre_MTPV.csv": ("A", "A", "Vs", "Vs", "Nm", "Nm"),
}


@pytest.mark.parametrize("name", PLAIN_FILES)
def test_files_made_by_others(shared_data: Path, name: str) -> None:
    path, units = shared_data / name, PLAIN_FILES[name]
    head, values = by_another_reader(path)
    table = read_table(path.read_bytes(), path.name)
    assert table.units == units
    assert [f"{title}_{unit}" for title, unit in zip(table.names, units, strict=True)] == head
    np.testing.assert_array_equal(table.values, values)
    assert table.lines.tolist() == list(range(2, len(values) + 2))
    german = path.read_text().replace(",", ";").replace(".", ",")
    np.testing.assert_array_equal(read(german).values, values)


def test_every_csv_of_others_is_tested(shared_data: Path) -> None:
    files = [path for folder in ("bemf", "fluxmaps") for path in (shared_data / folder).iterdir()]
    names = {f"{path.parent.name}/{path.name}" for path in files if path.suffix.lower() == ".csv"}
    assert names == {*PLAIN_FILES, *(f"bemf/{name}" for name in DRILL)}


DRILL = {
    "vdyno_drill_RedA0001CH2.CSV": ("CH2", 0.16, 1.6),
    "vdyno_drill_YellowA0001CH1.CSV": ("CH1", 0.0, -1.8),
}


@pytest.mark.parametrize("name", DRILL)
def test_samples_beside_the_settings_of_an_oscilloscope(shared_data: Path, name: str) -> None:
    channel, first, last = DRILL[name]
    path = shared_data / "bemf" / name
    table = read_table(path.read_bytes(), name)
    assert (table.names, table.units) == (("column 4", "column 5"), ("s", "V"))
    assert table.values.shape == (2500, 2)
    np.testing.assert_allclose(table.values[:, 0], -0.05 + 4e-5 * np.arange(2500), atol=1e-12)
    assert (table.values[0, 1], table.values[-1, 1]) == (first, last)
    np.testing.assert_array_equal(table.values, np.genfromtxt(path, delimiter=",", usecols=(3, 4)))
    assert table.lines.tolist() == list(range(1, 2501))
    assert {f"Source,{channel}", "Vertical Units,V", "Probe Atten,1.000000e+00"} <= set(
        table.preamble
    )
