"""A design in the browser: who is let in, what is kept, what is refused, and the same answers."""

from __future__ import annotations

import asyncio
import http.client
import io
import json
import re
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from scope_files import PSI, TIME, VOLTS, rows

from dqforge.machines.design import catalogue
from dqforge.machines.design.sheet_judged import checked_text
from dqforge.machines.design.sheet_values import BY_KEY
from dqforge.machines.files.positioned_yaml import parse_yaml
from dqforge.reports import answers
from dqforge.reports.answers.tune import answer_tune
from dqforge.reports.browser.server import (
    LARGEST_UPLOAD,
    DesignFolder,
    Server,
    Work,
    fields_of,
    known_keys,
)

HUB = {
    "machine.kv": "60 rpm/V",
    "machine.pole_pairs": "15",
    "machine.max_current": "40 A rms",
    "machine.resistance": "100 mOhm line-to-line",
    "machine.inductance": "200 uH line-to-line",
    "inverter.v_dc": "48 V",
}


class Page:
    """A page of a server, without a browser."""

    def __init__(self, server: Server, folder: Path) -> None:
        parts = urlsplit(server.address)
        self.place, self.token, self.folder = parts.netloc, parts.query.partition("=")[2], folder
        self.headers = {"Cookie": f"dqforge={self.token}", "Origin": f"http://{self.place}"}

    def ask(
        self, method: str, path: str, body: bytes | None = None, /, **headers: str | None
    ) -> tuple[int, http.client.HTTPMessage, bytes]:
        """Status, headers and content; a header that is None is left out."""
        connection = http.client.HTTPConnection(self.place, timeout=120)
        try:
            sent = {k: v for k, v in {**self.headers, **headers}.items() if v is not None}
            connection.request(method, path, body, sent)
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            connection.close()

    def post(self, path: str, **data: Any) -> dict[str, Any]:
        """What the server answers to data."""
        status, _, content = self.ask("POST", path, json.dumps(data).encode())
        assert status == 200, content
        found: dict[str, Any] = json.loads(content)
        return found

    def state(self) -> dict[str, Any]:
        """What the design file says."""
        found: dict[str, Any] = json.loads(self.ask("GET", "/api/state")[2])
        return found

    def new(
        self, files: Sequence[tuple[str, str, bytes]] = (), /, **asked: Any
    ) -> tuple[int, dict[str, Any]]:
        """What the form of a new design gives, with files as field, name and content."""
        parts = [
            ("asked", None, json.dumps({"revision": self.state()["revision"]} | asked).encode())
        ]
        body = b""
        for field, name, content in [*parts, *files]:
            more = "" if name is None else f'; filename="{name}"'
            body += f'--edge\r\nContent-Disposition: form-data; name="{field}"{more}\r\n'.encode()
            body += b"\r\n" + content + b"\r\n"
        kind = "multipart/form-data; boundary=edge"
        status, _, content = self.ask(
            "POST", "/api/new", body + b"--edge--\r\n", **{"Content-Type": kind}
        )
        return status, json.loads(content) if status == 200 else {}


async def _here(_: Work, function: Callable[..., dict[str, Any]], *args: Any) -> dict[str, Any]:
    """What a process of its own gives, without the seconds that it takes to begin."""
    return function(*args)


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    monkeypatch.setattr(Work, "done", _here)
    with served(tmp_path / "hub") as page:
        yield page


@pytest.fixture
def whole_page(tmp_path: Path) -> Iterator[Page]:
    """The same with its processes."""
    with served(tmp_path / "hub") as page:
        yield page


@contextmanager
def served(folder: Path) -> Iterator[Page]:
    """A server in a thread of its own."""
    server, ended, loop = Server(folder, 0), asyncio.Event(), asyncio.new_event_loop()
    thread = threading.Thread(target=lambda: loop.run_until_complete(server.serve(ended)))
    thread.start()
    try:
        yield Page(server, folder)
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(60)
        loop.close()


def begun(page: Page) -> dict[str, Any]:
    status, found = page.new(sheet=HUB)
    assert status == 200
    return found


EVERY = ("/", "/page.js", "/page.css", "/api/state", "/report", "/files.zip")


@pytest.mark.parametrize("path", EVERY)
@pytest.mark.parametrize(
    "headers",
    [
        {"Cookie": None},
        {"Cookie": "dqforge=guessed"},
        {"Cookie": "dqforge=\u00e9"},
        {"Host": "evil.example"},
        {"Host": "localhost"},
    ],
    ids=["no token", "another token", "no letters", "a name that leads here", "without the port"],
)
def test_nobody_else_is_let_in(page: Page, path: str, headers: dict[str, str | None]) -> None:
    assert page.ask("GET", path, None, **headers)[0] == 403


@pytest.mark.parametrize("origin", [None, "http://evil.example", "null"])
@pytest.mark.parametrize("path", ["text", "set", "new", "template", "answer"])
def test_another_page_changes_nothing(page: Page, path: str, origin: str | None) -> None:
    status, _, _ = page.ask("POST", f"/api/{path}", b"{}", Origin=origin)
    assert status == 403
    assert not page.folder.exists()


def test_the_printed_address_lets_in_and_the_token_is_gone_from_it(page: Page) -> None:
    status, headers, _ = page.ask("GET", f"/enter?token={page.token}", Cookie=None)
    assert status == 302
    assert headers["Location"] == "/"
    assert {"HttpOnly", "SameSite=Strict"} <= {p.strip() for p in headers["Set-Cookie"].split(";")}
    for wrong in ("guessed", "%C3%A9", ""):
        assert page.ask("GET", f"/enter?token={wrong}", Cookie=None)[0] == 403
    assert page.ask("GET", f"/enter?token={page.token}", Host="evil.example")[0] == 403


def test_a_page_asks_its_own_server_alone(page: Page) -> None:
    status, headers, content = page.ask("GET", "/")
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "unsafe" not in headers["Content-Security-Policy"]
    assert headers["Cache-Control"] == "no-store"
    assert b"http" not in content.replace(b"http-equiv", b"")


def test_a_data_sheet_becomes_the_design_file_and_its_fields(page: Page) -> None:
    state = begun(page)
    assert "error" not in state
    design = catalogue.load_design(page.folder / "design.yaml")
    assert design.machine.pole_pairs == 15
    values = {field["key"]: field["value"] for field in state["fields"]}
    assert values["machine.kv"] == "60 rpm/V"
    assert all(field["help"] for field in state["fields"])
    assert sorted(path.name for path in page.folder.iterdir()) == [
        "design.schema.json",
        "design.yaml",
    ]


def test_a_key_is_set_and_the_comments_stay(page: Page) -> None:
    state = begun(page)
    after = page.post("/api/set", settings=["inverter.v_dc=36 V"], revision=state["revision"])
    before, now = state["text"].splitlines(), after["text"].splitlines()
    assert [line for line in now if line not in before] == ["  v_dc: 36 V"]
    assert len(now) == len(before)


@pytest.mark.parametrize(
    ("path", "data"),
    [
        ("set", {"settings": ["inverter.v_dc=36 furlong"]}),
        ("set", {"settings": ["inverter.nothing=1"]}),
        ("text", {"text": "machine: {"}),
        ("text", {"text": "dqforge: 1\nname: x\n"}),
        ("template", {"machine": "../../secret"}),
    ],
)
def test_what_is_wrong_is_said_and_nothing_is_changed(
    page: Page, path: str, data: dict[str, Any]
) -> None:
    state = begun(page)
    found = page.post(f"/api/{path}", revision=state["revision"], **data)
    assert found["error"]
    assert "Traceback" not in found["error"]
    assert page.state()["text"] == state["text"]


def test_two_tabs_do_not_overwrite_each_other(page: Page) -> None:
    state = begun(page)
    page.post("/api/set", settings=["inverter.v_dc=36 V"], revision=state["revision"])
    late = page.post("/api/set", settings=["inverter.v_dc=24 V"], revision=state["revision"])
    assert late["stale"]
    assert "v_dc: 36 V" in late["text"]
    assert "v_dc: 36 V" in (page.folder / "design.yaml").read_text(encoding="utf-8")


def everything(page: Page) -> list[Path]:
    return sorted(page.folder.parent.rglob("*"))


SAID: tuple[tuple[dict[str, Any], str], ...] = (
    ({}, "the form is empty"),
    ({"sheet": {"machine.kv": "60 rpm/V"}}, "a design needs more of the data sheet; give --"),
    ({"sheet": {"export.prefix": "x"}}, "a data sheet has no 'export.prefix'"),
    (
        {"sheet": {"machine.flux_map.file": "../x.csv"}},
        "a data sheet has no 'machine.flux_map.file'",
    ),
    ({"sheet": HUB, "scale": "1,1,10"}, "--scale describes a file that is not given"),
    ({"sheet": HUB, "axes": "reluctance"}, "--axes describes a file that is not given"),
)


@pytest.mark.parametrize(("asked", "said"), SAID)
def test_a_form_that_makes_no_design_is_refused(
    page: Page, asked: dict[str, Any], said: str
) -> None:
    before = everything(page)
    assert page.new(**asked)[1]["error"].startswith(said)
    assert everything(page) == before


@pytest.mark.parametrize("field", ["map", "capture"])
@pytest.mark.parametrize(
    "name", ["../x.csv", "design.yaml", "design.schema.json", ".hidden", "a/b.csv", "C:\\x", "x\ty"]
)
def test_a_file_stays_in_the_folder(page: Page, field: str, name: str) -> None:
    before = everything(page)
    status, found = page.new([(field, name, b"1")], sheet=OF_FILES)
    assert status == 400 or "cannot be the name of a file" in found["error"]
    assert everything(page) == before


OF_FILES = {key: text for key, text in HUB.items() if key != "machine.kv"}
OF_MAP = {key: HUB[key] for key in ("machine.pole_pairs", "machine.resistance", "inverter.v_dc")}
OF_MAP |= {"machine.max_current": "4 A"}
CAPTURE = ("time_s,e_a_V,e_b_V,e_c_V\n" + rows((TIME, *VOLTS))).encode()


def flux_map(psi: float = 0.02) -> bytes:
    """Flux linkages of constant inductances over a square of 4 A."""
    axis = np.linspace(-4.0, 4.0, 9)
    i_d, i_q = (part.ravel() for part in np.meshgrid(axis, axis, indexing="ij"))
    columns = (i_d, i_q, psi + 2e-3 * i_d, 3e-3 * i_q)
    return ("i_d_A,i_q_A,psi_d_Wb,psi_q_Wb\n" + rows(columns)).encode()


def by_command(folder: Path, *options: str) -> tuple[dict[str, bytes], list[str]]:
    """What `dqforge new` writes and says."""
    words = [sys.executable, "-m", "dqforge.cli", "new", str(folder), *options]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder.parent)
    assert done.returncode == 0, done.stderr
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    return files, done.stdout.splitlines()


def options(sheet: dict[str, str]) -> list[str]:
    return [part for key, text in sheet.items() for part in (BY_KEY[key].flag, text)]


def test_a_capture_gives_the_magnet_flux_as_new_has_it(page: Page, tmp_path: Path) -> None:
    (tmp_path / "scope (1).csv").write_bytes(CAPTURE)
    given = ["--capture", "scope (1).csv", "--line-to-line", "--scale", "1,1,1"]
    files, said = by_command(tmp_path / "same", *options(OF_FILES), *given)
    found = page.new(
        [("capture", "scope (1).csv", CAPTURE)], sheet=OF_FILES, line_to_line=True, scale="1,1,1"
    )[1]
    assert {path.name: path.read_bytes() for path in page.folder.iterdir()} == files
    told = [note for note in found["notes"] if str(page.folder) not in note]
    assert len(told) >= 2
    assert all(any(note in line for line in said) for note in told)
    flux = re.search(r"magnet_flux: ([\d.]+) mWb peak", found["text"])
    assert flux is not None
    # Between two terminals the voltage is sqrt 3 times that of a phase.
    assert float(flux[1]) == pytest.approx(1e3 * PSI / np.sqrt(3.0), rel=2e-3)


def test_channels_of_a_capture_may_lie_in_several_files(page: Page) -> None:
    names = ("a", "b", "c")
    files = [
        ("capture", f"{name}.csv", (f"time_s,e_{name}_V\n" + rows((TIME, volts))).encode())
        for name, volts in zip(names, VOLTS, strict=True)
    ]
    found = page.new(files, sheet=OF_FILES)[1]
    assert "error" not in found
    assert sorted(path.name for path in page.folder.iterdir()) == [
        "design.schema.json",
        "design.yaml",
    ]


def test_a_flux_map_makes_a_design_and_lies_beside_it(page: Page, tmp_path: Path) -> None:
    (tmp_path / "map.csv").write_bytes(flux_map())
    files, _ = by_command(tmp_path / "same", *options(OF_MAP), "--map", "map.csv")
    found = page.new([("map", "map.csv", flux_map())], sheet=OF_MAP)[1]
    assert "error" not in found
    assert {path.name: path.read_bytes() for path in page.folder.iterdir()} == files
    design = catalogue.load_design(page.folder / "design.yaml")
    assert design.machine.pole_pairs == 15


HOSTILE = {
    "binary": bytes(range(256)) * 64,
    "wrong columns": b"a,b,c\n1,2,3\n4,5,6\n",
    "empty": b"",
    "a line of words": b"nothing here",
    "one row": b"time_s,e_a_V,e_b_V,e_c_V\n0,1,2,3\n",
    "no numbers": CAPTURE[:2000] + b"0.1,x,y,z\n",
    "an archive that is none": b"PK\x03\x04" + bytes(64),
}


@pytest.mark.parametrize("field", ["map", "capture"])
@pytest.mark.parametrize("kind", list(HOSTILE))
def test_a_file_that_is_none_is_refused_in_one_line(page: Page, field: str, kind: str) -> None:
    page.folder.mkdir()
    before = everything(page)
    sheet = OF_MAP if field == "map" else OF_FILES
    said = page.new([(field, "x.csv", HOSTILE[kind])], sheet=sheet)[1]["error"]
    assert "\n" not in said
    assert said.removeprefix("--map: ").startswith(
        "x.csv"
    )  # by the name that it had, not by where it was laid
    assert everything(page) == before
    good = flux_map() if field == "map" else CAPTURE
    assert "error" not in page.new([(field, "x.csv", good)], sheet=sheet)[1]


def test_more_than_is_taken_is_refused_before_it_is_sent(page: Page) -> None:
    assert f'data-largest="{LARGEST_UPLOAD}"'.encode() in page.ask("GET", "/")[2]
    connection = http.client.HTTPConnection(page.place, timeout=120)
    connection.putrequest("POST", "/api/new")
    for name, text in (page.headers | {"Content-Length": str(2 * LARGEST_UPLOAD)}).items():
        connection.putheader(name, text)
    connection.endheaders()
    assert connection.getresponse().status == 400
    connection.close()
    assert not page.folder.exists()


def test_a_flux_map_is_never_replaced(page: Page) -> None:
    page.folder.mkdir()
    (page.folder / "map.csv").write_bytes(b"1")
    said = page.new([("map", "map.csv", flux_map())], sheet=OF_MAP)[1]["error"]
    assert "map.csv exists already and is kept" in said
    (page.folder / "map.csv").write_bytes(flux_map())  # the same one is taken as it lies there
    assert "error" not in page.new([("map", "map.csv", flux_map())], sheet=OF_MAP)[1]


def test_a_capture_that_needs_an_option_of_bemf_has_a_way_out(page: Page) -> None:
    content = ("a,b,c\n" + rows((*VOLTS,))).encode()
    said = page.new([("capture", "x.csv", content)], sheet=OF_FILES)[1]["error"]
    assert "--interval" in said
    assert said.endswith(
        "'dqforge bemf' takes it: give the magnet flux that it finds by --magnet-flux"
    )


def test_files_of_one_name_are_refused(page: Page) -> None:
    two = [("capture", "a.csv", CAPTURE)] * 2
    assert "two files have the name a.csv" in page.new(two, sheet=OF_FILES)[1]["error"]
    maps = [("map", name, flux_map()) for name in ("a.csv", "b.csv")]
    assert "one flux map makes a design" in page.new(maps, sheet=OF_MAP)[1]["error"]


def test_a_design_begins_as_that_of_new(page: Page) -> None:
    begun(page)
    files = answers.library.design_files(
        checked_text(HUB, page.folder, {}).encode("utf-8")
    ).contents
    assert {path.name: path.read_bytes() for path in page.folder.iterdir()} == files


def test_data_of_no_form_are_refused(page: Page) -> None:
    for body in (b"", b"[]", b"{", b'{"kind": "rm"}', b'{"kind": "check", "settings": 3}'):
        assert page.ask("POST", "/api/answer", body)[0] == 400
        assert page.ask("POST", "/api/new", body)[0] == 400
    assert page.new(sheet=[1])[0] == 400
    assert page.ask("GET", "/files.zip?for=nobody")[0] == 404
    assert page.ask("GET", "/api/../../etc/passwd")[0] == 404


def test_answers_and_files_are_those_of_the_commands(whole_page: Page) -> None:
    page = whole_page
    begun(page)
    found = page.post("/api/answer", kind="tune", settings=["inverter.v_dc=40 V"], options={})
    design = catalogue.load_design(page.folder / "design.yaml", ["inverter.v_dc=40 V"])
    same = [[list(row) for row in table.rows] for table in answer_tune(design).tables]
    assert [table["rows"] for table in found["tables"]] == same
    assert found["figure"].startswith("<svg")
    assert "v_dc: 48 V" in page.state()["text"]  # for this answer alone
    _, headers, content = page.ask("GET", "/files.zip?for=vesc")
    assert headers["Content-Type"] == "application/zip"
    names = zipfile.ZipFile(io.BytesIO(content)).namelist()
    assert any(name.endswith("_mcconf.xml") for name in names)
    assert "error" in page.post("/api/answer", kind="simulate", settings=[], options={})


def test_a_server_begun_again_has_the_design(tmp_path: Path) -> None:
    folder = DesignFolder(tmp_path)
    folder.template("mini-cheetah-motor", folder.revision())
    assert DesignFolder(tmp_path).text() == folder.text() != ""


def test_every_value_of_every_library_design_has_a_field() -> None:
    keys = {entry["key"] for entry in known_keys()}
    assert len(keys) > 150
    for name in catalogue.names():
        text = catalogue.read_text(name).decode("utf-8")
        fields = fields_of(text)
        data: Any = parse_yaml(text.encode(), name).data
        for field in fields:
            found = data
            for part in field.key.split("."):
                found = found[part]
        sections = {field.key.split(".")[0] for field in fields}
        assert sections == set(data) - {"dqforge"}
