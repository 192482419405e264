"""What `dqforge check` answers: every value with its origin, and what was assumed."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.catalogue import OPTION
from dqforge.machines.design.design import Design
from dqforge.machines.design.plausible_figures import MARK
from dqforge.machines.names import SPEED_OBSERVER, TRACKER_NAMES
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.plain_data import plain_design


def _speed_on_observer(design: Design) -> bool:
    """Whether the speed loop runs on a position observer, or a tracker tells the angle, which
    physics may forbid: then a run may refuse it. A six-step drive is judged by itself.
    """
    control = design.control
    if control.observer is None or control.six_step is not None:
        return False
    if control.observer.method in TRACKER_NAMES:
        return control.gains != "none"
    return control.speed_loop is not None and control.observer.method != SPEED_OBSERVER


def answer_check(design: Design) -> Answer:
    """List what was read.

    Raises:
        InputError: The bases of fixed-point control do not hold the largest values, or the voltage
            feedback of the references has nothing to do or turns the flux.
        NoSolutionError: A loop does not hold, of a design whose speed loop runs on a position
            observer, it is a six-step drive that holds at no speed, or physics forbids its start.
    """
    stage("checking")
    leaving = _refuse(design)
    first, others = _values(design), []
    first = replace(first, notes=(*first.notes, *leaving)) if leaving else first
    if design.control.current_loop.switches:
        from dqforge.optimizer.current_feedback.regulator_runs import regulator_plan
        from dqforge.reports.single_headers.current_feedback import settings_table

        others.append(settings_table(regulator_plan(design)))
    options = () if design.places is None else dict.fromkeys(design.places.options.values())
    keys = tuple(option.removeprefix(f"{OPTION} ") for option in options)
    if keys:
        first = replace(first, notes=(f"set on the command line: {', '.join(keys)}", *first.notes))
    plain = {"input": plain_design(design)} | ({"set": list(keys)} if keys else {})
    return Answer(design.name, [first, *others], plain)


def _refuse(design: Design) -> tuple[str, ...]:
    """Refuse what cannot be; what an observer leaves of the speed loop.

    Each part is loaded where the design asks for it: most designs ask for none.
    """
    control = design.control
    leaving: tuple[str, ...] = ()
    if control.references.voltage_feedback is not None:
        from dqforge.optimizer.dynamic_references import require_feedback

        require_feedback(design)
    if control.six_step is not None:
        from dqforge.optimizer.six_step.design import solve_six_step

        solve_six_step(design)
    if any(form != "float32" for form in design.export.control):
        from dqforge.optimizer.fixed_control.design import require_scales

        require_scales(design)
    if _speed_on_observer(design):
        from dqforge.optimizer.control_design.gain_set import solve_gains
        from dqforge.optimizer.control_design.observed_remedies import require_observed
        from dqforge.reports.observers.speed_loop_text import beyond_notes, leaving_notes

        stage("evaluating the speed loop on its observer")
        gains = solve_gains(design)
        require_observed(design, gains)
        leaving = (*leaving_notes(gains.speed), *beyond_notes(gains.speed))
    stage("evaluating the start")
    if control.start_up is not None:
        from dqforge.optimizer.start_up.solve import solve_start_up

        solve_start_up(design)
    return leaving


def _values(design: Design) -> Table:
    """Every value with its origin, and what was assumed."""
    rows = tuple(
        (
            value.path,
            value.text,
            f"{value.si:.6g} {value.unit} {value.kind}".strip(),
            "inferred" if value.inferred else "",
            value.source,
        )
        for value in design.values
    )
    columns = ("key", "in the file", "in SI", "", "source")
    odd = [sentence for sentence in design.assumptions if sentence.startswith(MARK)]
    taken = (f"assumed: {each}" for each in design.assumptions if not each.startswith(MARK))
    notes = (*odd, *taken)
    return Table(f"{design.name}: valid", columns, rows, notes)
