"""Figure of the choice of modulator and switching frequency: a map of the best, the rule upon it,
and mean losses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.modulation_choice.rule import Leaf, Rule, SimplifiedChoice
from dqforge.optimizer.modulation_choice.solve import ModulationChoice, PricedRule
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    title,
)
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.capability import Capability, Draw, Passage, ReportPart
from dqforge.reports.modulation_choice.rule_model import (
    Alternative,
    EmittedRule,
    emitted_from,
    emitted_rule,
    plain_emitted,
    rule_inputs,
    rule_results,
    rule_text,
)
from dqforge.reports.modulation_choice.text import (
    alternative_text,
    binding_shares,
    choice_rows,
    choice_tables,
    hertz,
    kept_text,
    limits_text,
    plain_choice,
    question_text,
    rule_lines,
)
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    MAP_INK,
    MUTED,
    PALE,
    PAPER,
    SKY,
    TEAL,
    label_in_unit,
    new_figure,
    style,
)
from dqforge.reports.pages.html_text import HtmlTable, Row, quantity, share, watts
from dqforge.reports.pages.templating import (
    MODULATION,
    WINNERS,
    cell_edges,
    draw_cells,
    inside,
    render,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Colours of the switching frequency, low to high.
_FREQUENCIES = (
    "#eef3f8",
    "#d5e3f0",
    "#b5cfe5",
    "#8fb8d9",
    "#659dc9",
    "#3f80b5",
    "#24629a",
    "#123f6b",
)

_EXTRA = ("#8a6d9e", "#6fa8a0", "#cfa0a0", "#7f8c5a")
_NOTHING = "#d9d9d9"
_BARS = {"best": TEAL, "rule": BLUE, "other": SKY, "today": PALE}
_BOX = {"boxstyle": "round,pad=0.2", "facecolor": PAPER, "edgecolor": "none", "alpha": 0.85}
_ROW = 0.2
Box = tuple[float, float, float, float]


def _borders(values: FloatArray) -> FloatArray:
    """Borders of the cells, the first at zero: a rule holds from there on."""
    borders = cell_edges(values)
    borders[0] = 0.0
    return borders


def leaf_boxes(rule: Rule, box: Box) -> list[tuple[Leaf, Box]]:
    """Answers of a rule with the rectangles (speed from, to in rad/s, torque from,
    to in N m) where they are given.
    """
    if isinstance(rule, Leaf):
        return [(rule, box)]
    left, right, low, high = box
    if rule.quantity == "torque_Nm":
        cut = min(max(rule.threshold, low), high)
        parts = (left, right, low, cut), (left, right, cut, high)
    else:
        cut = min(max(rule.threshold, left), right)
        parts = (left, cut, low, high), (cut, right, low, high)
    return [*leaf_boxes(rule.below, parts[0]), *leaf_boxes(rule.above, parts[1])]


def _draw_rule(axes: Axes, choice: ModulationChoice, *, named: bool) -> None:
    """Borders of the emitted rule, and in each part what it takes."""
    from matplotlib.patches import Rectangle

    rule, box = choice.emitted, (0.0, *_ends(choice.omega_m), 0.0, *_ends(choice.torque))
    wanted, speed = np.meshgrid(choice.torque, choice.omega_m, indexing="ij")
    asked = choice.asked.reshape(wanted.shape)
    boxes = leaf_boxes(rule.rule, box)
    for leaf, (left, right, low, high) in boxes:
        corner, size = (in_rpm(left), low), (in_rpm(right - left), high - low)
        name, frequency = rule.alternatives[leaf.choice]
        if len(boxes) > 1:
            axes.add_patch(
                Rectangle(
                    corner,
                    *size,
                    fill=False,
                    edgecolor=MAP_INK,
                    linewidth=1.3,
                    zorder=4,
                    label=f"_{name}, {hertz(frequency)}",
                )
            )
        here = asked & (speed >= left) & (speed < right) & (wanted >= low) & (wanted < high)
        if named and np.any(here):
            i, j = inside(here)
            rows, columns = np.any(here, axis=1), np.any(here, axis=0)
            layout = _layout(float(np.mean(columns)), float(np.mean(rows)))
            axes.text(
                in_rpm(choice.omega_m[j]),
                choice.torque[i],
                f"{name}{layout.separator}{hertz(frequency)}",
                ha="center",
                va="center",
                fontsize=layout.size,
                fontweight="bold",
                rotation=layout.rotation,
                bbox=_BOX,
                zorder=5,
            )


@dataclass(frozen=True, slots=True)
class _Layout:
    """How an answer is written into its part of the map."""

    separator: str
    rotation: float = 0.0
    size: float = 7.0


def _layout(width: float, height: float) -> _Layout:
    """The first layout that fits into a part of the map, whose sides are shares of the map's."""
    if width >= 0.24 and height >= 0.13:
        return _Layout("\n")
    if width >= 0.42 and height >= 0.07:
        return _Layout(", ")
    if height >= 0.42:
        return _Layout(", ", 90.0)
    return _Layout(", " if width >= 0.3 else "\n", size=5.0)


def _ends(values: FloatArray) -> tuple[float]:
    return (float(_borders(values)[-1]),)


def _axes_of_map(axes: Axes, choice: ModulationChoice, title: str) -> None:
    axes.set(
        xlim=(0.0, in_rpm(_ends(choice.omega_m)[0])),
        ylim=(0.0, _ends(choice.torque)[0]),
        xlabel="Speed in rpm",
    )
    axes.grid(visible=False)
    axes.set_title(title)
    label_in_unit(axes.yaxis, "Torque in {}", float(choice.torque[-1]), "N m")


def _legend(axes: Axes, entries: list[tuple[str, str]], columns: int) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=colour, edgecolor=FAINT, linewidth=0.5, label=label)
        for colour, label in entries
    ]
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.0, -0.17),
        ncols=columns,
        frameon=False,
        fontsize=6.8,
        handlelength=1.0,
        handletextpad=0.4,
        columnspacing=0.9,
        labelspacing=0.35,
        borderaxespad=0.0,
    )


def _draw_modulators(axes: Axes, choice: ModulationChoice) -> None:
    best = choice.best.modulation.reshape(choice.torque.size, -1)
    names, counts = np.unique(best[best >= 0], return_counts=True)
    ranked = [int(k) for k in names[np.argsort(-counts, kind="stable")]]
    colours = [*WINNERS, *_EXTRA][: len(ranked)]
    code = np.full(best.shape, -1)
    for place, k in enumerate(ranked):
        code[best == k] = place
    idle = choice.reached.reshape(best.shape) & (best < 0)
    code[idle] = len(ranked)
    draw_cells(
        axes, code, in_rpm(_borders(choice.omega_m)), _borders(choice.torque), [*colours, _NOTHING]
    )
    entries: list[tuple[str, str]] = [
        (colour, choice.best.modulations[k]) for colour, k in zip(colours, ranked, strict=True)
    ]
    entries += [(_NOTHING, "limits not kept")] if np.any(idle) else []
    _legend(axes, entries, 4)


def _draw_frequencies(axes: Axes, choice: ModulationChoice) -> None:
    f_sw = choice.best.f_sw.reshape(choice.torque.size, -1)
    known = np.isfinite(f_sw)
    edges = _frequency_edges(f_sw[known])
    code: NDArray[np.int64] = np.full(f_sw.shape, -1)
    code[known] = np.clip(np.searchsorted(edges, f_sw[known], side="right") - 1, 0, len(edges) - 2)
    step = len(_FREQUENCIES) / max(len(edges) - 1, 1)
    colours = [
        _FREQUENCIES[min(int((k + 0.5) * step), len(_FREQUENCIES) - 1)]
        for k in range(len(edges) - 1)
    ]
    code[choice.reached.reshape(f_sw.shape) & ~known] = len(colours)
    draw_cells(
        axes, code, in_rpm(_borders(choice.omega_m)), _borders(choice.torque), [*colours, _NOTHING]
    )
    if len(edges) == 2:
        entries = [(colours[0], hertz(float(np.mean(f_sw[known]))))]
    else:
        entries = [
            (colour, f"{low / 1e3:.3g} to {high / 1e3:.3g} kHz")
            for colour, low, high in zip(colours, edges[:-1], edges[1:], strict=True)
        ]
    _legend(axes, entries, 3)


def _frequency_edges(values: FloatArray) -> FloatArray:
    """At most eight classes of frequencies in Hz, with round borders, even in the logarithm."""
    low, high = float(np.min(values)), float(np.max(values))
    if high < 1.02 * low:
        return np.array([low * 0.99, high * 1.01])
    edges = np.geomspace(low, high, len(_FREQUENCIES) + 1)
    inner = np.unique([float(f"{edge:.2g}") for edge in edges[1:-1]])
    return np.array([low, *inner[(inner > low) & (inner < high)], high])


def _draw_losses(axes: Axes, choice: ModulationChoice) -> None:
    """Bars of the mean losses: best choice, rules, this design."""
    rows: list[tuple[str, float, str, str]] = [
        ("best at every point", choice.best_mean, "", _BARS["best"]),
        *(_bar(choice, rule) for rule in reversed(choice.rules)),
    ]
    today = choice.today
    if math.isfinite(today.mean_loss):
        text = _price_text(choice, today)
        rows.append(
            (
                f"today: {alternative_text(today.alternatives[0])}",
                today.mean_loss,
                text,
                _BARS["today"],
            )
        )
    largest = max(row[1] for row in rows)
    for y, (_, loss, text, colour) in enumerate(rows):
        axes.barh(-y, loss, height=0.72, color=colour, edgecolor=PAPER, linewidth=0.5)
        axes.annotate(
            f"{loss:.4g} W{text}",
            (loss, -y),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=7.0,
            color=INK,
        )
    axes.set(
        xlim=(0.0, 1.5 * largest),
        ylim=(-len(rows) + 0.4, 0.6),
        xlabel="Mean loss in W over the map",
    )
    axes.set_yticks([-y for y in range(len(rows))], [row[0] for row in rows])
    axes.tick_params(axis="y", length=0.0, labelsize=7.0)
    axes.spines["left"].set_color(MUTED)
    axes.grid(visible=False, axis="y")


def _bar(choice: ModulationChoice, rule: PricedRule) -> tuple[str, float, str, str]:
    label = (
        f"rule with {question_text(rule.questions)}"
        if rule.questions
        else alternative_text(rule.alternatives[0])
    )
    emitted = rule is choice.emitted
    text = _price_text(choice, rule) + ("  \u25c0 in the header" if emitted else "")
    return label, rule.mean_loss, text, _BARS["rule" if emitted else "other"]


def _price_text(choice: ModulationChoice, rule: PricedRule) -> str:
    price = 100.0 * choice.price(rule) + 0.0
    sign = "+" if price >= 0.0 else "\u2212"
    return f" ({sign}{abs(price):.3g} %)" + ("" if rule.permitted else ", breaks limits")


def plot_choice(choice: ModulationChoice) -> Figure:
    """Best modulator, best switching frequency with the rule of the header upon both,
    and mean losses below.
    """
    below, legend = 5 * _ROW + 0.45, 0.85
    height = 2.55 + legend + below + 0.35
    bottom = (below + legend) / height
    with style():
        figure = new_figure(
            "choice",
            height,
            "Best modulator and switching frequency over torque and speed, rule, and mean losses",
        )
        left = figure.add_axes((0.075, bottom, 0.405, 2.55 / height))
        right = figure.add_axes((0.58, bottom, 0.405, 2.55 / height))
        _draw_modulators(left, choice)
        _draw_rule(left, choice, named=False)
        _axes_of_map(left, choice, "Modulator with the least loss")
        _draw_frequencies(right, choice)
        _draw_rule(right, choice, named=True)
        _axes_of_map(right, choice, "Its frequency, and the rule of the header")
        lower = figure.add_axes((0.235, 0.36 / height, 0.75, (below - 0.45) / height))
        _draw_losses(lower, choice)
    return figure


# The header of the rule that chooses modulator and switching frequency.

_SEED = 20_261_121


def rule_header(
    design: Design,
    found: SimplifiedChoice,
    alternatives: Sequence[Alternative],
    *,
    reach: tuple[float, float] = (1.0, 1.0),
    limits: Sequence[str] = (),
) -> dict[str, bytes]:
    """Names and bytes of the header with the rule and of its test vectors.

    Only what the rule takes is in it.

    Args:
        design, found, alternatives: The rule with its price, and what its leaves number.
        reach: Largest torque in N m and mechanical speed in rad/s of the map that the rule was made
            for.
        limits: Lines on what was kept, for the comment.
    """
    prefix = design.export.prefix
    model = emitted_rule(found.rule, alternatives, reach)
    context = {
        **title(design),
        "part": "modulation",
        "subject": "modulator and switching frequency",
        "includes": ["<math.h> /* fabsf */"],
        "body": rule_text(model, prefix),
        "vectors": False,
        "preamble": [
            (
                "Least mean loss over the operating points of the design that so few questions can "
                "have:"
            ),
            (
                f"{found.mean_loss:.4g} W, {rounded_up(100.0 * found.price)} % above the best "
                "alternative at every point."
            ),
            *(
                []
                if found.permitted
                else ["No such rule keeps all limits at every point; this one breaks them least."]
            ),
            *limits,
        ],
    }
    inputs = rule_inputs(model, design.export.vectors, _SEED)
    results = rule_results(model, inputs)
    vectors = np.concatenate([inputs, results], axis=1)
    text = render("c_code/header.h.j2", context)
    return _HARNESS.files(design, text, vectors)


_HARNESS = Harness(
    "modulation",
    "torque in N m, mechanical speed in rad/s; number of the choice and of its modulator, "
    "switching frequency in Hz",
    (2, 3),
    (
        "const @_choice_t choice = @_modulation_choice(in[0], in[1]);",
        "",
        "out[0] = (float)(int)choice;",
        "out[1] = (float)(int)@_modulator(choice);",
        "out[2] = @_switching_frequency_Hz(choice);",
    ),
)


def choice_model(choice: ModulationChoice) -> EmittedRule:
    """The model of the header of a design's choice."""
    rule = choice.emitted
    return emitted_rule(rule.rule, _alternatives(choice), _reach(choice))


def choice_files(design: Design, choice: ModulationChoice) -> dict[str, bytes]:
    """Names and bytes of the header with a design's rule and of its test vectors."""
    limits = [f"{line}." for line in limits_text(choice.settings)]
    return rule_header(
        design, choice.simplified(), _alternatives(choice), reach=_reach(choice), limits=limits
    )


def _alternatives(choice: ModulationChoice) -> list[Alternative]:
    return [Alternative(name, frequency) for name, frequency in choice.emitted.alternatives]


def _reach(choice: ModulationChoice) -> tuple[float, float]:
    return float(choice.torque[-1]), float(choice.omega_m[-1])


def rule_programme(rule: EmittedRule) -> Programme:
    """The harness of a rule for the modulator, with what its model answers."""
    half = SWEEP_POINTS // 2
    inputs = rule_inputs(rule, half, SWEEP_SEED, patterns=half)
    return Programme(_HARNESS, inputs, rule_results(rule, inputs), "choice of modulator")


# The choice of modulator and switching frequency in the report.


def choice_passage(choice: ModulationChoice, prefix: str) -> Passage:
    """What the report says of the choice of modulator and frequency."""
    left_out = _left_out(choice)
    text = (
        "Every watt of the drive is counted at every torque and speed with every modulator over "
        f"the permitted switching frequencies. {_text(choice)}{f' {left_out}' if left_out else ''}"
    )
    caption = (
        "Top: modulator with the least loss, and its switching frequency; dark lines part the map "
        "where the rule of the header takes another one, whose name stands there. Left blank: "
        "beyond current and voltage. Of modulators that lose the same the first in the design is "
        "shown. Bottom: what each simplification loses."
    )
    declared = (
        f"{prefix}_choice_t {prefix}_modulation_choice(float torque_Nm, float speed_rad_per_s);",
        f"{prefix}_modulator_t {prefix}_modulator({prefix}_choice_t choice);",
        f"float {prefix}_switching_frequency_Hz({prefix}_choice_t choice);",
    )
    return Passage(
        text=[text],
        drawings=[("choice", caption)],
        tables=[_prices(choice), _rule_data(choice)],
        declaration="\n".join(declared),
    )


def _text(choice: ModulationChoice) -> str:
    first, *others = limits_text(choice.settings)
    limits = "; ".join([first, *(line[0].lower() + line[1:] for line in others)])
    shares = binding_shares(choice)
    bound = ", ".join(f"{name} at {share(part)}" for name, part in shares.items())
    bound = (
        f"What binds the best choice, by share of the points: {bound}."
        if bound
        else "No limit binds."
    )
    return f"{limits}. {bound}"


def _left_out(choice: ModulationChoice) -> str:
    idle = choice.idle_share
    return (
        f"At {share(idle)} of the map nothing keeps all limits; rule and means exclude these "
        "points."
        if idle > 0.0
        else ""
    )


def _cells(choice: ModulationChoice, label: str, rule: PricedRule) -> tuple[str, ...]:
    taken = ", ".join(alternative_text(part) for part in rule.alternatives)
    if not math.isfinite(rule.mean_loss):
        return (label, taken, "\u2013", "\u2013", kept_text(rule))
    price = choice.price(rule)
    sign = "+" if price >= 0.0 else "\u2212"
    return (label, taken, watts(rule.mean_loss), f"{sign}{share(abs(price), 3)}", kept_text(rule))


def _prices(choice: ModulationChoice) -> HtmlTable:
    rows = [Row(("best at every point", "any", watts(choice.best_mean), "", "kept"), "best")]
    for rule in reversed(choice.rules):
        label = f"rule with {question_text(rule.questions)}" if rule.questions else "one everywhere"
        rows.append(Row(_cells(choice, label, rule), "chosen" if rule is choice.emitted else ""))
    rows.append(Row(_cells(choice, "this design", choice.today), "muted"))
    columns = ("", "modulator and frequency", "mean loss", "above the best", "limits")
    return HtmlTable("Mean losses over the map, all points alike", columns, tuple(rows), 2)


def _rule_data(choice: ModulationChoice) -> HtmlTable:
    lines = rule_lines(choice.emitted.rule, choice.emitted.alternatives)
    return HtmlTable(
        "The rule in the header",
        ("where", "modulator and frequency"),
        tuple(Row(line) for line in lines),
        2,
    )


# The choice of modulator and switching frequency, as one record.


def _figures(_: Solution, choice: ModulationChoice) -> Mapping[str, Draw]:

    return {"choice": lambda: plot_choice(choice)}


def _parts(solution: Solution, choice: ModulationChoice) -> list[ReportPart]:
    key = f"mean loss {quantity(choice.emitted.mean_loss, 'W')}"
    return [choice_passage(choice, solution.design.export.prefix).of(MODULATION, key)]


MODULATION_CHOICE = Capability(
    name="modulation_choice",
    title="modulator and switching frequency",
    of=lambda outcome: outcome.solution.choice,
    plain=lambda _, choice: plain_choice(choice),
    summary=lambda _, choice: choice_rows(choice),
    tables=lambda solution, choice: choice_tables(solution.design, choice),
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="modulation",
            files=lambda solution, choice: choice_files(solution.design, choice),
            plain=lambda _, choice: plain_emitted(choice_model(choice)),
            read=lambda own, _: emitted_from(own),
            programme=rule_programme,
        ),
    ),
)
