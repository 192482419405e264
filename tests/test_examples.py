"""Every example runs from its first cell to its last, in a folder of its own."""

from __future__ import annotations

import ast
import json
import re
import runpy
from pathlib import Path

import pytest
from notebooks import NOTEBOOKS, notebooks

FOLDER = Path(__file__).resolve().parent.parent / "examples"

SAID = {
    "fit_and_certificate": "torque error proven",
    "from_standstill": "baldor-pmsyrm-5k6: RUN at 1000",
    "loops_and_tolerances": "method 'bandwidth' holds up to",
    "losses_and_waveforms": "third harmonic 18.0 %, fifth 6.0 %",
    "machine_from_arrays": "results equal the model bit for bit",
    "mtpa_and_field_weakening": "held by",
}


def test_every_example_is_run() -> None:
    assert {path.stem for path in FOLDER.glob("*.py")} == set(SAID)


# Run with the campaign; by default the ten lines of docs/reference/python.md do what the last two
# do.
LONG = {
    "fit_and_certificate",
    "from_standstill",
    "loops_and_tolerances",
    "machine_from_arrays",
    "mtpa_and_field_weakening",
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in SAID]
)
def test_examples_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    runpy.run_path(str(FOLDER / f"{name}.py"))
    assert SAID[name] in capsys.readouterr().out
    assert list(tmp_path.glob("*.svg"))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_examples_are_cells(path: Path) -> None:
    """Editors open them as notebooks: a title first, and text and code in turn."""
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# %% [markdown]\n# # ")
    cells = re.split(r"^# %%", text, flags=re.MULTILINE)[1:]
    assert [cell.startswith(" [markdown]\n") for cell in cells] == [
        k % 2 == 0 for k in range(len(cells))
    ]
    assert len(cells) >= 4


def test_notebooks_are_the_examples() -> None:
    """Written by ``python tests/notebooks.py``."""
    written = {path: path.read_text(encoding="utf-8") for path in NOTEBOOKS.glob("*")}
    assert written == notebooks()


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_says_what_its_script_says(path: Path) -> None:
    """Its code cells, one after the other, are the script without its text."""
    told = json.loads(path.read_text(encoding="utf-8"))
    code = ["".join(cell["source"]) for cell in told["cells"] if cell["cell_type"] == "code"]
    script = (FOLDER / f"{path.stem}.py").read_text(encoding="utf-8")
    assert ast.dump(ast.parse("\n".join(code))) == ast.dump(ast.parse(script))
    assert {cell["id"] for cell in told["cells"]} == {
        f"cell-{k}" for k in range(len(told["cells"]))
    }
