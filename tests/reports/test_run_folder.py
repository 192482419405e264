"""What the report of a run lists is what the run wrote, under the names and with the hashes of its
manifest.
"""

from __future__ import annotations

import hashlib
import html
import re
from pathlib import Path
from urllib.parse import unquote

from drives import SURFACE, make_design

from dqforge.machines.design.design import DesignFiles
from dqforge.reports.output.folder import RUN, read_manifest, write_output
from dqforge.reports.run import run_design
from dqforge.reports.run_folder import MANIFEST, listed_files


def test_every_file_of_a_run_is_linked_with_its_hash(tmp_path: Path) -> None:
    design = make_design(SURFACE)
    output = run_design(design, verify=False)
    assert all(output.told[name] for name in output.files if name != "report.html")
    write_output(tmp_path, RUN, output.files, design)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = re.findall(r'<a href="([^"#]+)"><code>[^<]*</code></a></th>(.*?)</tr>', report)
    linked = {unquote(html.unescape(link)): row for link, row in rows}
    manifest = read_manifest(tmp_path)
    assert set(linked) == {*manifest.files, MANIFEST} - {"report.html"}
    for name, row in linked.items():
        assert (tmp_path / name).is_file()
        if name != MANIFEST:
            content = (tmp_path / name).read_bytes()
            assert hashlib.sha256(content).hexdigest()[:12] in row
            assert manifest.files[name] == hashlib.sha256(content).hexdigest()


def test_what_the_design_was_read_from_is_listed() -> None:
    given = DesignFiles(b"name: x\n", (("maps/../maps/one.csv", b"1\n"),))
    listed = listed_files({"a.h": b"a"}, {"a.h": "a header"}, given)
    assert [file.name for file in listed] == [
        "a.h",
        "dqforge-input/design.yaml",
        "dqforge-input/files/maps/one.csv",
        MANIFEST,
    ]
    assert all(file.what for file in listed)
    assert listed[-1].size is None
    assert not listed[-1].digest
