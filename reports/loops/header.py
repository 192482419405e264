"""The C header of current-loop gains over the current and its test vectors,
as plain data and as text.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.loops.schedule.schedule_fit import GAIN_NAMES, GainEvaluator
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.read_back import single_from, singles_from
from dqforge.reports.c_code.title import title
from dqforge.reports.loops.proven_text import changing_lines
from dqforge.reports.loops.schedule_text import schedule_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.loops.schedule.gain_schedule import GainSchedule

_SEED = 20_261_121


_MOST_VALUES = 256


_FAULT = InputError("gains_header is not what dqforge writes; run the design again")


def _list(values: SingleArray) -> list[float]:
    return [shortest(value) for value in values]


def plain_evaluator(evaluator: GainEvaluator) -> PlainData:
    """The evaluator as plain data; every number is a float32 value."""
    return {
        "end": shortest(evaluator.end),
        "fallback": {name: shortest(value) for name, value in evaluator.fallback.items()},
        "constants": {name: shortest(value) for name, value in evaluator.constants.items()},
        "starts": _list(evaluator.starts),
        "polynomials": {
            name: [_list(row) for row in rows] for name, rows in evaluator.polynomials.items()
        },
        "inverse_step": shortest(evaluator.inverse_step),
        "tables": {name: _list(values) for name, values in evaluator.tables.items()},
    }


def evaluator_from(plain: Mapping[str, Any]) -> GainEvaluator:
    """Read an evaluator back.

    Raises:
        InputError: The data are not what `plain_evaluator` makes.
    """
    try:
        found = GainEvaluator(
            end=single_from(plain["end"]),
            fallback={name: single_from(plain["fallback"][name]) for name in GAIN_NAMES},
            constants={name: single_from(value) for name, value in plain["constants"].items()},
            starts=singles_from(plain["starts"], _MOST_VALUES),
            polynomials={
                name: np.stack([singles_from(row, _MOST_VALUES) for row in rows])
                for name, rows in plain["polynomials"].items()
            },
            inverse_step=single_from(plain["inverse_step"]),
            tables={
                name: singles_from(values, _MOST_VALUES) for name, values in plain["tables"].items()
            },
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _FAULT from error
    names = sorted([*found.constants, *found.polynomials, *found.tables])
    sizes = {table.size for table in found.tables.values()}
    rows = {rows.shape[0] for rows in found.polynomials.values()}
    reach = float(found.end) * float(found.inverse_step)
    sound = (
        names == sorted(GAIN_NAMES)
        and found.end > 0.0
        and not (found.tables and found.polynomials)
        and (not found.tables or (len(sizes) == 1 and min(sizes) > 1 and 0.0 < reach < min(sizes)))
        and (not found.polynomials or rows == {found.starts.size})
        and found.starts[0] == 0.0
        and bool(np.all(np.diff(found.starts) > 0.0))
    )
    if not sound:
        raise _FAULT
    return found


def schedule_inputs(
    evaluator: GainEvaluator, count: int, seed: int, patterns: int = 0
) -> SingleArray:
    """Currents i_q in A, shape (count + patterns + 20,): all over the domain and beyond it,
    special ones, any bits.
    """
    generator = np.random.default_rng(seed)
    end = float(evaluator.end)
    across = (generator.uniform(-1.2, 1.2, count) * end).astype(np.float32)
    beside = [
        np.nextafter(np.float32(v), np.float32(s))
        for v in (end, *evaluator.starts[1:])
        for s in (0.0, np.inf)
    ]
    special = [
        0.0,
        -0.0,
        np.nan,
        -np.nan,
        np.inf,
        -np.inf,
        1e-45,
        -1e-45,
        end,
        -end,
        *evaluator.starts.tolist(),
        *beside,
    ]
    bits = generator.integers(0, 2**32, patterns, dtype=np.uint32).view(np.float32)
    return np.concatenate([np.array(special, dtype=np.float32), across, bits])


def _context(design: Design, gains: GainSet, schedule: GainSchedule) -> PlainData:
    evaluator = schedule.fit.evaluator
    plain = plain_evaluator(evaluator)
    ends = [*plain["starts"][1:], None]
    segments = [
        {
            "start": start,
            "end": end,
            "polynomials": [
                (name, plain["polynomials"][name][place]) for name in plain["polynomials"]
            ],
        }
        for place, (start, end) in enumerate(zip(plain["starts"], ends, strict=True))
    ]
    return {
        **title(design),
        "form": plain,
        "names": GAIN_NAMES,
        "segments": segments,
        "points": max((len(values) for values in plain["tables"].values()), default=0),
        "preamble": [
            (
                f"Method {design.control.current_loop.method}, sampled every "
                f"{design.control.t_s * 1e6:.6g} us."
            ),
            (
                "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
                "errors hold either way."
            ),
        ],
        "comment": [
            (
                "i_q_A: q-axis current in A as it is measured, either sign; beyond SCHEDULE_END "
                "the gains stay as they are there."
            ),
            (
                "kp_d, kp_q: proportional gains, V/A; ki_ts_d, ki_ts_q: integral gains times the "
                "sampling period, V/A."
            ),
            (
                "Parallel form: I[k] = I[k-1] + ki_ts[k] e[k], d[k] = kp[k] e[k] + I[k]; or as "
                "differences d[k] = d[k-1] + kp[k] e[k] - kp[k-1] e[k-1] + ki_ts[k] e[k]."
            ),
            (
                "Not d[k-1] + kp[k] (e[k] - e[k-1]) + ki_ts[k] e[k]: what kp changes by would stay "
                "in d for good, and the loop can grow though it is stable at every current."
            ),
            "Not-a-number gives the constant gains, those for the least inductance.",
            "",
            *schedule_lines(schedule),
            *changing_lines(gains),
            "Margins are those of frozen currents along the current reference.",
        ],
    }


def gains_files(design: Design, gains: GainSet, schedule: GainSchedule) -> dict[str, bytes]:
    """Names and bytes of the header of gains over the current and of its test vectors."""
    context, prefix, evaluator = (
        _context(design, gains, schedule),
        design.export.prefix,
        schedule.fit.evaluator,
    )
    inputs = schedule_inputs(evaluator, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs[:, np.newaxis], evaluator.gains(inputs)], axis=1)
    texts = {
        f"{prefix}_gains.h": render("loops/gains.h.j2", context),
        f"{prefix}_gains_vectors.h": render(
            "loops/vectors.h.j2", context | {"vectors": [list(row) for row in vectors]}
        ),
    }
    return {name: text.encode("ascii") for name, text in texts.items()}


def gains_programme(evaluator: GainEvaluator) -> Programme:
    """The harness of scheduled gains, with what their model answers."""
    half = SWEEP_POINTS // 2
    currents = schedule_inputs(evaluator, half, SWEEP_SEED, patterns=half)
    return Programme(
        "loops/harness.c.j2", currents, evaluator.gains(currents), name="gains over the current"
    )
