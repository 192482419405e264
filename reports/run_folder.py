"""What lies in the folder of a run: the names of what stands beside the emitted files, and what
each file is.
"""

from __future__ import annotations

import posixpath
from collections.abc import Mapping

from dqforge.machines.design.design import DesignFiles
from dqforge.reports.page_frame import ListedFile

# Name of the list of the files in its folder; it is written last.
MANIFEST = "dqforge-manifest.json"

# Folder in the output folder that holds the design file and, below ``files``, those that it names.
INPUT = "dqforge-input"
INPUT_DESIGN = f"{INPUT}/design.yaml"
RESULT, REPORT = "result.json", "report.html"


def input_files(given: DesignFiles | None, root: str = INPUT) -> dict[str, bytes]:
    """The files from which a design can be read again, by their names in the output folder."""
    if given is None:
        return {}
    named = {f"{root}/files/{posixpath.normpath(name)}": content for name, content in given.named}
    return {f"{root}/design.yaml": given.text} | named


def listed_files(
    files: Mapping[str, bytes], told: Mapping[str, str], given: DesignFiles | None
) -> list[ListedFile]:
    """The files of a run as its report lists them.

    Args:
        files: What the run wrote before the report, by name.
        told: What each is, by name.
        given: What the design was read from.
    """
    inputs = input_files(given)
    words = {INPUT_DESIGN: "the design, as it was read"}
    listed = [ListedFile.of(name, told.get(name, ""), files[name]) for name in files]
    listed += [
        ListedFile.of(name, words.get(name, "a file that the design names"), content)
        for name, content in inputs.items()
    ]
    return [*listed, ListedFile(MANIFEST, "every file of this folder with its SHA-256")]
