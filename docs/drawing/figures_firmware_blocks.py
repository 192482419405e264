"""Block drawings of the emitted C: the chain of the control, files, build and check on a core."""

from __future__ import annotations

import re
from pathlib import Path

from blocks import Block, arrow, draw, label, sheet
from page_text import DOCS

from dqforge import emit, load_design
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, PURPLE, TEAL, save, style

_CHAIN = (
    ("_speed_control", "filter, PI at every ratio-th call", TEAL),
    ("_torque_control", "current references of the torque", PURPLE),
    ("_current_control", "Clarke, Park, PI, decoupling, limit", BLUE),
    ("_duties", "modulator, held within 0 and 1", ORANGE),
)

_HANDED = ("torque", "$i_d$ and $i_q$", "voltage of the stator", "duty cycles of the phases")

_NEEDED = ("speed", "speed, DC link", "all of them", "DC link")


@style()
def control_chain(path: Path) -> None:
    """What each control function does, what it is given and what it hands to the next."""
    figure, axes = sheet("control-chain", 3.95, "Control functions from speed to duty cycles")
    chain = [
        Block(0.15, 3.85 - 0.95 * row, 3.5, name, (words,), colour)
        for row, (name, words, colour) in enumerate(_CHAIN)
    ]
    measured = Block(5.4, 2.65, 1.45, "measured", ("currents", "angle", "speed", "DC link"), MUTED)
    draw(axes, *chain, measured)
    for block, handed, needed in zip(chain, _HANDED, _NEEDED, strict=True):
        below = block.bottom[0], block.y - 0.95
        arrow(axes, block.bottom, below)
        label(axes, (below[0] + 0.12, below[1] + 0.2), handed, "left")
        turn = 5.15, block.right[1]
        arrow(axes, measured.left, (turn[0], measured.left[1]), turn, block.right)
        label(axes, (4.45, turn[1] + 0.13), needed)
    save(figure, path)


_FILES = (
    ("hub_main.c", 0, 0, "main(), interrupt of the sample", MUTED),
    ("hub_application.h", 0, 1, "_application_step(): states, faults", TEAL),
    ("hub_hardware.h", 1, 1, "_read(), _write(): yours to fill in", MUTED),
    ("hub_startup.h", 0, 2, "_startup_step(): from standstill on", PURPLE),
    ("hub_observer.h", 1, 2, "_flux_step(): angle and speed", ORANGE),
    ("hub_control.h", 0, 3, "_speed_control() to _duties()", BLUE),
    ("hub_vectors.h", 1, 4, "_vectors_mismatches(): 0 is right", MUTED),
    ("hub.h", 0, 4, "_current_reference(), macros", BLUE),
)

_EMITTED = {
    "export.control": "float32",
    "export.application": "skeleton",
    "control.observer": {"method": "flux"},
    "control.start_up": {},
}


@style()
def headers(path: Path) -> None:
    """Files that a drive without an encoder gets, and which of them includes which."""
    files = emit(load_design(DOCS / "how-to" / "files" / "hub.yaml", _EMITTED)).files
    figure, axes = sheet("header-files", 4.2, "Emitted files and what they include")
    blocks = {
        name: Block(0.15 + 3.5 * column, 4.1 - 0.83 * row, 3.15, name, (words,), colour)
        for name, column, row, words, colour in _FILES
    }
    draw(axes, *blocks.values())
    for name, block in blocks.items():
        for other in (blocks[found] for found in re.findall(r'#include "([^"]+)"', files[name])):
            if block.y == other.y:
                ends = (block.right, other.left) if block.x < other.x else (block.left, other.right)
            else:
                ends = block.bottom, other.top
            arrow(axes, *ends)
    save(figure, path)


@style()
def build(path: Path) -> None:
    """From the design to the firmware, and the check that both still belong together."""
    figure, axes = sheet("header-build", 2.65, "A build that makes its header")
    design = Block(0.1, 2.6, 1.3, "hub.yaml", ("the design",), TEAL)
    made = Block(2.95, 2.6, 1.6, "generated/", ("hub.h", "hub_vectors.h", "result.json"))
    source = Block(2.95, 1.0, 1.6, "main.c", ("calls both",), MUTED)
    program = Block(5.35, 1.75, 1.55, "firmware", ("returns 0:", "every bit agrees"), ORANGE)
    draw(axes, design, made, source, program)
    arrow(axes, design.right, (made.x, design.right[1]))
    label(axes, (2.17, design.right[1] + 0.13), "dqforge export,")
    label(axes, (2.17, design.right[1] - 0.13), "if it is younger")
    arrow(axes, made.right, (4.95, made.right[1]), (4.95, 1.5), (program.x, 1.5))
    arrow(axes, source.right, (4.95, source.right[1]), (4.95, 1.3), (program.x, 1.3))
    label(axes, (4.85, 1.31), "cc -std=c99", "right")
    arrow(axes, (made.x, 1.8), (design.bottom[0], 1.8), design.bottom, dashed=True)
    label(axes, (1.85, 1.66), "dqforge verify generated")
    save(figure, path)


@style()
def harness(path: Path) -> None:
    """One set of inputs through the model and through the compiled C, and the bits compared."""
    page = (DOCS / "how-to" / "verify-on-an-emulated-core.md").read_text(encoding="utf-8")
    counted = re.search(r"verification +(\d+) results", page)
    assert counted is not None
    figure, axes = sheet("core-harness", 2.9, "One set of inputs through model, host and core")
    inputs = Block(0.1, 1.92, 1.4, "inputs", ("special values", "breakpoints", "random bits"), TEAL)
    model = Block(1.95, 2.8, 2.35, "model in Python", ("float32 and integers",), PURPLE)
    host = Block(1.95, 1.72, 2.35, "header on the host", ("cc C99, c++ C++11",))
    core = Block(1.95, 0.64, 2.35, "header on the core", ("arm-none-eabi, QEMU",), ORANGE)
    same = Block(4.95, 2.1, 1.95, "every bit equal?", (f"{counted.group(1)} results",), TEAL)
    cost = Block(4.95, 0.64, 1.95, "what is executed", ("instructions, cycles",), ORANGE)
    draw(axes, inputs, model, host, core, same, cost)
    for block in (model, host, core):
        arrow(axes, inputs.right, (1.73, inputs.right[1]), (1.73, block.left[1]), block.left)
        arrow(axes, block.right, (4.63, block.right[1]), (4.63, same.left[1]), same.left)
    arrow(axes, core.right, cost.left)
    save(figure, path)
