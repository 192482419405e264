"""`dqforge serve`: a page in the browser of this machine, behind a token, for one design folder."""

from __future__ import annotations

import asyncio
import copy
import hashlib
import json
import re
import secrets
import signal
import socket
import sys
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from functools import cache
from hmac import compare_digest
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.web import Application, HTTPError, RequestHandler

from dqforge.machines.design import catalogue
from dqforge.machines.design.sheet_values import BY_KEY, SHEET_VALUES
from dqforge.machines.errors import DqforgeError, InputError, shown
from dqforge.machines.files.library_files import DESIGN_SCHEMA, schema_bytes
from dqforge.machines.files.positioned_yaml import YamlValue, edited, parse_yaml, written
from dqforge.machines.records import dataclass
from dqforge.reports import answers
from dqforge.reports.browser import computed
from dqforge.reports.command_line.designs import NEW_DESIGN
from dqforge.reports.firmware.target import TARGETS
from dqforge.reports.output.folder import put_files
from dqforge.reports.pages.templating import render, resource

# The one state of `dqforge serve`: a design file in a folder, with its flux map beside it.

# Bytes of the files that are taken at once: maps and captures.
LARGEST_UPLOAD = 64_000_000
# Bytes of the form around them.
_FORM = 1_000_000

_NAME = re.compile(r"\w[\w ()+._-]{0,99}")


class ChangedElsewhereError(Exception):
    """The design file is no longer what the page shows."""


@dataclass(frozen=True, slots=True)
class DesignFolder:
    """A folder and its design file."""

    folder: Path

    @property
    def path(self) -> Path:
        """The design file, which may not be there yet."""
        return self.folder / NEW_DESIGN

    def text(self) -> str:
        """What it says; empty where it is not there."""
        return self.path.read_text(encoding="utf-8-sig") if self.path.is_file() else ""

    def revision(self) -> str:
        """What tells one text from another."""
        return hashlib.sha256(self.text().encode("utf-8")).hexdigest()[:16]

    def save(self, text: str, revision: str) -> None:
        """Keep a text that is a design.

        Raises:
            ChangedElsewhereError: The file is not of that revision.
            InputError: The text is no design; says where and why.
        """
        self.require(revision)
        content = text.encode("utf-8")
        catalogue.load_text(content, str(self.path), self.folder)
        put_files(self.folder, {NEW_DESIGN: content})

    def change(self, settings: Sequence[str], revision: str) -> None:
        """Set keys of the design, as ``--set`` does; comments stay. Raises as `save`."""
        self.require(revision)
        data = catalogue.parse_design(self.text().encode("utf-8"), str(self.path)).data
        changed = copy.deepcopy(data)
        for setting in settings:
            catalogue.put(changed, catalogue.read_override(setting))
        self.save(edited(self.text(), data, changed), revision)

    def begin(self, contents: Mapping[str, bytes], revision: str) -> None:
        """Keep the files of a new design. Raises `ChangedElsewhereError` as `save`."""
        self.require(revision)
        put_files(self.folder, contents)

    def template(self, machine: str, revision: str) -> None:
        """Begin with a drive or motor of the library. Raises as `save`."""
        self.require(revision)
        text = catalogue.template(machine)
        put_files(self.folder, answers.library.design_files(text).contents)

    def require(self, revision: str) -> None:
        """Raise `ChangedElsewhereError` where the file is not of a revision."""
        if revision != self.revision():
            raise ChangedElsewhereError


def given_sheet(sheet: Mapping[str, Any]) -> dict[str, str]:
    """What is written in a form of a data sheet, without its empty fields.

    Raises:
        InputError: A data sheet has no such value.
    """
    given = {str(key): str(text).strip() for key, text in sheet.items() if str(text).strip()}
    unknown = sorted(set(given) - set(BY_KEY))
    if unknown:
        raise InputError(f"a data sheet has no {shown(unknown[0])}")
    return given


# The form: each key of the design with what the schema says of it.


@dataclass(frozen=True, slots=True)
class Field:
    """A key with its value as it is written, what it is, and its choices, empty for any."""

    key: str
    value: str
    help: str
    choices: tuple[str, ...]
    whole: bool


def fields_of(text: str) -> list[Field]:
    """A field for each value of a design's text."""
    if not text:
        return []
    data = parse_yaml(text.encode("utf-8"), NEW_DESIGN).data
    schema = _schema()
    return [
        _field(schema, path, value) for path, value in _leaves(data, ()) if path[0] != "dqforge"
    ]


def known_keys() -> list[dict[str, str]]:
    """Every key that a design can have, with what it is."""
    schema = _schema()
    return [
        {"key": ".".join(path), "help": node.get("description", "")}
        for path, node in _paths(schema, schema, (), 0)
    ]


@cache
def _schema() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(schema_bytes(DESIGN_SCHEMA))
    return found


def _leaves(value: YamlValue, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], YamlValue]]:
    """Values by their paths; one with a kind or an origin beside it is one value."""
    if isinstance(value, dict) and value and "value" not in value:
        for key, part in value.items():
            yield from _leaves(part, (*path, str(key)))
    elif path:
        yield path, value


def _field(schema: dict[str, Any], path: tuple[str, ...], value: YamlValue) -> Field:
    node, more = _at(schema, path), ""
    if isinstance(value, dict) and value:
        more = "".join(f"; {key}: {part}" for key, part in value.items() if key != "value")
        value = value["value"]
    choices = tuple(str(one) for one in node.get("enum", ()))
    whole = isinstance(value, int) and "integer" in _types(node)
    text = "" if value is None else written(value)
    about = node.get("description", "") + more
    return Field(".".join(path), text, about.removeprefix("; "), choices, whole)


def _types(node: dict[str, Any]) -> set[str]:
    found: set[str] = set()
    for part in (node, *node.get("anyOf", ())):
        kinds = part.get("type", [])
        found.update([kinds] if isinstance(kinds, str) else kinds)
    return found


def _resolved(schema: dict[str, Any], node: dict[str, Any]) -> list[dict[str, Any]]:
    """A node of the schema and what it may be instead, references followed."""
    parts = [node, *node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("allOf", ())]
    found = []
    for part in parts:
        target = part.get("$ref", "").rpartition("/")[2]
        found.append({**schema["$defs"][target], **part} if target else part)
    return found


def _at(schema: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    """The node of a key; empty where the schema has none."""
    node = schema
    for part in path:
        below = [one.get("properties", {}) for one in _resolved(schema, node)]
        node = next((properties[part] for properties in below if part in properties), {})
    return node


def _paths(
    schema: dict[str, Any], node: dict[str, Any], path: tuple[str, ...], depth: int
) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    sections = [one for one in _resolved(schema, node) if one.get("properties")]
    if path and (not sections or depth >= _DEEPEST):
        yield path, node
        return
    seen: set[str] = set()
    for section in sections:
        for key, part in section["properties"].items():
            if key not in seen and (path or key != "dqforge"):
                seen.add(key)
                yield from _paths(schema, part, (*path, key), depth + 1)


_DEEPEST = 4


# `dqforge serve`: a page in the browser of this machine, behind a token, for one design folder.

HOST = "127.0.0.1"
_COOKIE = "dqforge"
_WORKERS = 2

# Scripts, styles and requests of the page's own server; pictures also as data within it.
_OWN_ALONE = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; form-action 'none'; frame-ancestors 'none'; base-uri 'none'"
)
# The report brings its scripts and styles along and asks nobody.
_REPORT_ALONE = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "font-src data:; form-action 'none'; frame-ancestors 'none'; base-uri 'none'"
)


def serve(folder: Path, port: int, *, as_json: bool) -> None:
    """Serve a design folder to a browser on this machine.

    Args:
        folder: Holds the design file, or will.
        port: Of the loopback address; 0: a free one.
        as_json: Whether address and design are printed as JSON, and the page is not opened.

    Raises:
        InputError: The folder is a file, or the port is taken.
    """
    if folder.is_file():
        raise InputError(
            f"{folder} is a file; give the folder of a design, {folder.parent} perhaps"
        )
    try:
        server = Server(folder, port)
    except OSError as error:
        reason = error.strerror or "it is not available"
        raise InputError(f"--port: {port}: {reason}; omit it for a free one") from None
    path = str(folder / NEW_DESIGN)
    said = f"{path} in the browser: {server.address}\nCtrl-C ends it"
    if as_json:
        said = json.dumps({"address": server.address, "design": path})
    sys.stdout.write(f"{said}\n")
    sys.stdout.flush()
    if not as_json:
        webbrowser.open(server.address)
    asyncio.run(_until_ended(server))


async def _until_ended(server: Server) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        try:
            loop.add_signal_handler(number, ended.set)
        except NotImplementedError:  # Windows: Ctrl-C is an exception there
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(ended.set))
    await server.serve(ended)


class Work:
    """Answers, computed in processes of their own, which begin anew where one of them breaks."""

    def __init__(self) -> None:
        self._pool = self._made()

    @staticmethod
    def _made() -> ProcessPoolExecutor:
        return ProcessPoolExecutor(_WORKERS, get_context("spawn"), computed.warm)

    async def done(self, function: Callable[..., dict[str, Any]], *args: Any) -> dict[str, Any]:
        """What a function of `computed` gives."""
        try:
            return await asyncio.wrap_future(self._pool.submit(function, *args))
        except BrokenProcessPool:
            self._pool = self._made()
            return {"error": "the computation was interrupted; try again"}

    def end(self) -> None:
        """Leave the processes to themselves: they end with this one."""
        self._pool.shutdown(wait=False, cancel_futures=True)


class _Plain(RequestHandler):
    """A request with the token, and for no other host than this; errors are a line of text."""

    def require(self, token: str) -> None:
        """Refuse another host and another token."""
        settings = self.application.settings
        known = compare_digest(token.encode("utf-8"), settings["token"].encode("utf-8"))
        if self.request.host != settings["place"] or not known:
            raise HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Content-Security-Policy", _OWN_ALONE)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        said = {403: "open the address that 'dqforge serve' has printed", 404: "not here"}
        self.finish(said.get(status_code, "this failed; saved data are kept") + "\n")


class _Guarded(_Plain):
    """A request from the page that this server gave out, and from nobody else."""

    folder: DesignFolder
    work: Work

    def initialize(self, folder: DesignFolder, work: Work) -> None:
        self.folder, self.work = folder, work

    def prepare(self) -> None:
        """Refuse whom `require` refuses, and changes from other pages."""
        self.require(self.get_cookie(_COOKIE, ""))
        own = f"http://{self.application.settings['place']}"
        if self.request.method not in {"GET", "HEAD"} and self.request.headers.get("Origin") != own:
            raise HTTPError(403)

    def answer(self, found: dict[str, Any]) -> None:
        """Write data as JSON."""
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(json.dumps(found))

    def asked(self, text: str | bytes | None = None) -> dict[str, Any]:
        """The data of the request, or of a part of it."""
        try:
            found = json.loads(self.request.body if text is None else text)
        except ValueError:
            raise HTTPError(400) from None
        if not isinstance(found, dict):
            raise HTTPError(400)
        return found

    def state(self) -> dict[str, Any]:
        """What the design file says, and what is wrong with it."""
        text = self.folder.text()
        try:
            fields = [asdict(field) for field in fields_of(text)]
        except DqforgeError as error:
            return {
                "text": text,
                "revision": self.folder.revision(),
                "fields": [],
                "error": str(error),
            }
        return {"text": text, "revision": self.folder.revision(), "fields": fields}

    def stale(self) -> dict[str, Any]:
        """The same, for a page that did not know it."""
        said = "the design was changed elsewhere; this is its present content"
        return self.state() | {"error": said, "stale": True}


class _Enter(_Plain):
    """The address that is printed: its token becomes a cookie of this page alone."""

    def get(self) -> None:
        """Let in who has the token."""
        given = self.get_query_argument("token", "")
        self.require(given)
        self.set_cookie(_COOKIE, given, httponly=True, samesite="Strict", path="/")
        self.redirect("/")


class _Page(_Guarded):
    def get(self) -> None:
        """The page."""
        context = {
            "sheet": [asdict(value) | {"label": value.label} for value in SHEET_VALUES],
            "asked": list(computed.ASKED),
            "targets": {name: target.title for name, target in sorted(TARGETS.items())},
            "library": [*catalogue.names(), *catalogue.motors()],
            "keys": known_keys(),
            "folder": str(self.folder.folder),
            "largest": LARGEST_UPLOAD,
        }
        self.finish(render("browser/page.html.j2", context))


class _Part(_Guarded):
    """The page's style and script."""

    def get(self, name: str) -> None:
        """One of them."""
        kind = {"page.css": "text/css", "page.js": "text/javascript"}[name]
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish(resource(f"browser/{name}"))


class _State(_Guarded):
    def get(self) -> None:
        """What the design file says."""
        self.answer(self.state())

    def post(self, what: str) -> None:
        """Change it."""
        asked = self.asked()
        revision = str(asked.get("revision", ""))
        try:
            if what == "text":
                self.folder.save(str(asked["text"]), revision)
            elif what == "set":
                self.folder.change([str(one) for one in asked["settings"]], revision)
            else:
                self.folder.template(str(asked["machine"]), revision)
        except ChangedElsewhereError:
            self.answer(self.stale())
        except DqforgeError as error:
            self.answer({"error": str(error)})
        except (KeyError, TypeError, ValueError):
            raise HTTPError(400) from None
        else:
            self.answer(self.state())


class _New(_Guarded):
    async def post(self) -> None:
        """Make the design of a data sheet and of files of measurements."""
        asked = self.asked(self.get_body_argument("asked", ""))
        revision = str(asked.get("revision", ""))
        try:
            sent = self._sent(asked)
            self.folder.require(revision)
            found = await self.work.done(computed.begun, self.folder.folder, sent)
            if "error" not in found:
                self.folder.begin(found["contents"], revision)
                found = self.state() | {"notes": found["notes"]}
        except ChangedElsewhereError:
            found = self.stale()
        except DqforgeError as error:
            found = {"error": str(error)}
        self.answer(found)

    def _sent(self, asked: dict[str, Any]) -> computed.Sent:
        """Data and files of the form; raises as `_files` and `given_sheet`."""
        sheet = asked.get("sheet", {})
        if not isinstance(sheet, dict):
            raise HTTPError(400)
        maps, captures = self._files("map"), self._files("capture")
        if len(maps) > 1:
            raise InputError("one flux map makes a design; take one of the files away")
        return computed.Sent(
            given_sheet(sheet),
            next(iter(maps.items()), None),
            captures,
            str(asked.get("axes") or "") or None,
            str(asked.get("scale") or "").strip() or None,
            bool(asked.get("line_to_line")),
        )

    def _files(self, field: str) -> dict[str, bytes]:
        """Contents of the files of a field by their names.

        Raises:
            InputError: A name is no plain one, or two have the same.
        """
        found: dict[str, bytes] = {}
        for one in self.request.files.get(field, ()):
            name = one["filename"]
            if not _NAME.fullmatch(name) or name in {NEW_DESIGN, DESIGN_SCHEMA}:
                raise InputError(
                    f"{shown(name)} cannot be the name of a file here; rename it: letters, digits"
                )
            if name in found:
                raise InputError(f"two files have the name {name}; rename one of them")
            found[name] = one["body"]
        return found


class _Answer(_Guarded):
    async def post(self) -> None:
        """An answer for the design, with keys that are set for it alone."""
        asked = self.asked()
        kind, settings = asked.get("kind"), asked.get("settings", [])
        options = asked.get("options", {})
        if (
            kind not in computed.ASKED
            or not isinstance(settings, list)
            or not isinstance(options, dict)
        ):
            raise HTTPError(400)
        path = str(self.folder.path)
        texts = {str(key): str(value) for key, value in options.items()}
        made = [str(one) for one in settings]
        self.answer(await self.work.done(computed.answered, path, kind, made, texts))


class _Files(_Guarded):
    async def get(self) -> None:
        """Headers, or the files of a firmware, as a download."""
        firmware = self.get_query_argument("for", "")
        if firmware and firmware not in TARGETS:
            raise HTTPError(404)
        found = await self.work.done(computed.files_of, str(self.folder.path), firmware)
        if "error" in found:
            self.answer(found)
            return
        self.set_header("Content-Type", "application/zip")
        self.set_header(
            "Content-Disposition", f"attachment; filename*=UTF-8''{quote(found['name'])}"
        )
        self.finish(found["content"])


class _Report(_Guarded):
    async def get(self) -> None:
        """The report of a whole run."""
        found = await self.work.done(computed.report_of, str(self.folder.path))
        if "error" in found:
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish(found["error"] + "\n")
            return
        self.set_header("Content-Security-Policy", _REPORT_ALONE)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(found["content"])


class Server:
    """A server that listens, with the address to open."""

    def __init__(self, folder: Path, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind((HOST, port))
        self._socket.listen(64)
        self._socket.setblocking(False)
        place = f"{HOST}:{self._socket.getsockname()[1]}"
        token = secrets.token_urlsafe(24)
        self.address = f"http://{place}/enter?token={token}"
        self._work = Work()
        parts: dict[str, Any] = {"folder": DesignFolder(folder), "work": self._work}
        self._application = Application(
            [
                (r"/enter", _Enter),
                (r"/", _Page, parts),
                (r"/(page\.css|page\.js)", _Part, parts),
                (r"/api/state", _State, parts),
                (r"/api/(text|set|template)", _State, parts),
                (r"/api/new", _New, parts),
                (r"/api/answer", _Answer, parts),
                (r"/files\.zip", _Files, parts),
                (r"/report", _Report, parts),
            ],
            token=token,
            place=place,
            log_function=_silent,
        )

    async def serve(self, ended: asyncio.Event) -> None:
        """Answer until the event is set."""
        server = HTTPServer(self._application, max_buffer_size=LARGEST_UPLOAD + _FORM)
        server.add_sockets([self._socket])
        try:
            await ended.wait()
        finally:
            server.stop()
            self._work.end()


def _silent(_: RequestHandler | HTTPServerRequest) -> None:
    """No line per request."""
