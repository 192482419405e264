"""A design in the browser: who is let in, what is kept, what is refused, and the same answers."""

from __future__ import annotations

import asyncio
import http.client
import io
import json
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.sheet_judged import checked_text
from dqforge.machines.errors import InputError
from dqforge.machines.files.positioned_yaml import parse_yaml
from dqforge.reports import answers
from dqforge.reports.answers.tune import answer_tune
from dqforge.reports.browser.server import DesignFolder, Server, fields_of, known_keys

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


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    folder = tmp_path / "hub"
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
    return page.post("/api/new", sheet=HUB, revision=page.state()["revision"])


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
@pytest.mark.parametrize("path", ["text", "set", "new", "template", "answer", "upload/a.csv"])
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
        ("new", {"sheet": {"machine.kv": "60"}}),
        ("new", {"sheet": {"export.prefix": "x"}}),
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


@pytest.mark.parametrize("name", ["..%2Fx.csv", "design.yaml", ".hidden", "a%2Fb.csv", "a%00.csv"])
def test_a_file_stays_in_the_folder(page: Page, name: str) -> None:
    begun(page)
    before = sorted(page.folder.parent.rglob("*"))
    page.ask("POST", f"/api/upload/{name}", b"1")
    assert sorted(page.folder.parent.rglob("*")) == before


def test_a_file_comes_before_the_design(page: Page) -> None:
    """The form hands over the flux map first: there is no folder yet."""
    assert json.loads(page.ask("POST", "/api/upload/map.csv", b"1")[2]) == {"name": "map.csv"}
    assert (page.folder / "map.csv").read_bytes() == b"1"


def test_a_design_begins_as_that_of_new(page: Page) -> None:
    begun(page)
    files = answers.library.design_files(
        checked_text(HUB, page.folder, {}).encode("utf-8")
    ).contents
    assert {path.name: path.read_bytes() for path in page.folder.iterdir()} == files


def test_a_file_is_kept_once_and_never_replaced(page: Page) -> None:
    begun(page)
    assert json.loads(page.ask("POST", "/api/upload/map.csv", b"1")[2]) == {"name": "map.csv"}
    assert json.loads(page.ask("POST", "/api/upload/map.csv", b"1")[2]) == {"name": "map.csv"}
    assert (
        "another content" in json.loads(page.ask("POST", "/api/upload/map.csv", b"2")[2])["error"]
    )
    assert (page.folder / "map.csv").read_bytes() == b"1"


def test_data_of_no_form_are_refused(page: Page) -> None:
    for body in (b"", b"[]", b"{", b'{"kind": "rm"}', b'{"kind": "check", "settings": 3}'):
        assert page.ask("POST", "/api/answer", body)[0] == 400
    assert page.ask("GET", "/files.zip?for=nobody")[0] == 404
    assert page.ask("GET", "/api/../../etc/passwd")[0] == 404


def test_answers_and_files_are_those_of_the_commands(page: Page) -> None:
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
    folder.begin(HUB, folder.revision())
    assert DesignFolder(tmp_path).text() == folder.text()
    with pytest.raises(InputError, match="a data sheet has no control"):
        folder.begin({"control.x": "1"}, folder.revision())


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
