"""Study files with one fault each: (name, content, line, column, phrase that the message must
contain). Plain data; lines and columns were counted by hand in `BASE`.
"""

from __future__ import annotations

BASE = """\
dqforge_study: 1
name: Trial
design: paper000-ipmsm-100kw
vary:
  inverter.switching_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 3}}
  operation.strategy: [mtpa, id0]
set:
  fit.degree: 3
tolerances:
  machine.resistance: {normal: 5 %}
  inverter.v_dc: {uniform: 10 %}
draw: {count: 10, seed: 1}
accept:
  gains.phase_margin: {above: 60 deg}
limits:
  losses.total: 900 W
pareto: {minimise: [losses.total]}
sensitivity: [losses.total]
"""


def changed(*pairs: tuple[str, str]) -> str:
    """`BASE` with phrases replaced, each of which occurs exactly once."""
    text = BASE
    for old, new in pairs:
        if text.count(old) != 1:
            raise ValueError(f"{old!r} does not occur exactly once")
        text = text.replace(old, new)
    return text


_RANGE = "{range: {from: 60 kHz, to: 100 kHz, count: 3}}"
_WORDS = "[mtpa, id0]"
_NORMAL = "{normal: 5 %}"
_DRAW = "draw: {count: 10, seed: 1}"
_NLOPT = "search: {method: nlopt, seed: 1}\n"
_DRAWN_KEYS = "tolerances:\n  machine.resistance: {normal: 5 %}\n  inverter.v_dc: {uniform: 10 %}"

Broken = tuple[str, str, int, int, str]


def _range(text: str) -> str:
    return changed((_RANGE, f"{{range: {text}}}"))


_FILE: list[Broken] = [
    ("empty", "", 1, 1, "the file is empty; a study begins with dqforge_study: 1"),
    ("design", "dqforge: 1\nname: a\n", 1, 1, "this is a design; a study begins with"),
    (
        "version",
        changed(("study: 1", "study: 2")),
        1,
        16,
        "version 1 of the format, got 2; write dqforge_study: 1",
    ),
    ("no-version", changed(("dqforge_study: 1\n", "")), 1, 1, "write dqforge_study: 1"),
    ("no-design", changed(("design: paper000-ipmsm-100kw\n", "")), 1, 1, "needs the key 'design'"),
    ("no-such-drive", changed(("paper000-ipmsm", "paper000-ipsm")), 3, 9, "did you mean paper000"),
    ("no-such-file", changed(("paper000-ipmsm-100kw", "a.yaml")), 3, 9, "no design 'a.yaml'"),
    ("far-file", changed(("paper000-ipmsm-100kw", "/etc/a.yaml")), 3, 9, "outside the folder"),
    ("unknown", changed(("accept:", "acept:")), 13, 1, "did you mean 'accept'?"),
    ("twice", BASE + "draw: {count: 3, seed: 1}\n", 19, 1, "given twice"),
    ("no-value", changed(("fit.degree: 3", "fit.degree:")), 8, 3, "has no value"),
    (
        "vary-list",
        changed((f"{_RANGE}\n  operation.strategy: {_WORDS}", "3")),
        5,
        33,
        "write [...]",
    ),
]

_KEYS: list[Broken] = [
    (
        "misspelt",
        changed(("switching_frequency:", "switching_frequncy:")),
        5,
        3,
        (
            "vary.inverter.switching_frequncy: no such key in a design; did you mean "
            "inverter.switching_frequency?"
        ),
    ),
    ("synonym", changed(("machine.resistance", "machine.r_s")), 10, 3, "mean machine.resistance?"),
    ("no-section", changed(("inverter.v_dc", "v_dc")), 11, 3, "did you mean inverter.v_dc"),
    ("inside-entry", changed(("fit.degree", "machine.poles.value")), 8, 3, "write machine.poles:"),
    ("set-unknown", changed(("fit.degree", "fit.degre")), 8, 3, "did you mean fit.degree?"),
    (
        "set-and-vary",
        changed(("fit.degree: 3", "operation.strategy: id0")),
        6,
        3,
        "set.operation.strategy sets it as well; leave one of the two out",
    ),
    (
        "vary-and-draw",
        changed(("inverter.v_dc", "inverter.switching_frequency")),
        11,
        3,
        "vary.inverter.switching_frequency sets it as well",
    ),
    (
        "part-of-it",
        changed(
            ("fit.degree: 3", "inverter.device.on_resistance: 1 mOhm"),
            (_WORDS, _WORDS + ("\n  inverter.device: [{name: sirectifier-sii400s12}]")),
        ),
        7,
        3,
        "set.inverter.device.on_resistance sets a part of it",
    ),
    ("set-value", changed(("fit.degree: 3", "inverter.dead_time: 1 V")), 8, 3, "expected a time"),
]

_VALUES: list[Broken] = [
    ("unit", _range("{from: 60 V, to: 100 kHz, count: 3}"), 5, 48, "expected a frequency"),
    ("comma", _range("{from: '60,5 kHz', to: 100 kHz, count: 3}"), 5, 48, "write 60.5 kHz"),
    (
        "cut-comma",
        _range("{from: 60,5 kHz, to: 100 kHz, count: 3}"),
        5,
        51,
        "'60,5 kHz' has a decimal comma",
    ),
    ("range-key", _range("{from: 60 kHz, till: 1 kHz, count: 3}"), 5, 56, "unknown key 'till'"),
    ("no-end", _range("{from: 60 kHz, count: 3}"), 5, 34, "needs the key 'to'"),
    ("no-count", _range("{from: 60 kHz, to: 80 kHz}"), 5, 34, "needs the key 'count'"),
    ("count", _range("{from: 60 kHz, to: 80 kHz, count: -3}"), 5, 75, "expected 2 to 100000"),
    ("part-count", _range("{from: 60 kHz, to: 80 kHz, count: 2.5}"), 5, 75, "a whole number"),
    ("equal", _range("{from: 60 kHz, to: 60 kHz, count: 3}"), 5, 60, "both ends are equal"),
    ("spacing", _range("{from: 6, to: 7, count: 3, spacing: lg}"), 5, 77, "did you mean 'log'?"),
    ("log", _range("{from: -6, to: 7, count: 3, spacing: log}"), 5, 48, "log needs positive ends"),
    ("two-forms", changed((_RANGE, "{values: [1 kHz], files: a}")), 5, 3, "got values and files"),
    ("no-form", changed((_RANGE, "{one_by_one: true}")), 5, 3, "expected one of values, range"),
    ("empty-list", changed((_WORDS, "[]")), 6, 23, "expected 1 to 100000 values, got 0"),
    ("word", changed((_WORDS, "[mtpa, idd0]")), 6, 30, "did you mean 'id0'?"),
    ("again", changed((_WORDS, "[mtpa, id0, mtpa]")), 6, 23, "value 3 is value 1 again"),
    ("equal-numbers", changed((_RANGE, "[60 kHz, 60000]")), 5, 33, "value 2 is value 1 again"),
    ("drawn-here", changed((_RANGE, "{normal: 5 %}")), 5, 42, "write it under tolerances"),
    ("range-of-words", changed((_WORDS, "{range: {from: 1, to: 2, count: 2}}")), 6, 24, "values:"),
    ("all-numbers", changed((_RANGE, "{values: all}")), 5, 42, "only words can be all"),
    ("one-by-one", changed((_WORDS, "{values: all, one_by_one: true}")), 6, 49, "holds a list"),
    (
        "all-at-once",
        changed((f"operation.strategy: {_WORDS}", "losses.modulations: {values: all}")),
        6,
        32,
        "write one_by_one: true beside",
    ),
    (
        "one-by-one-word",
        changed(
            (
                f"operation.strategy: {_WORDS}",
                "losses.modulations: {values: [svm], one_by_one: true}",
            )
        ),
        6,
        33,
        "did you mean 'svpwm'",
    ),
    (
        "device",
        changed((f"operation.strategy: {_WORDS}", "inverter.device: [{name: fuji-2mbi300xbe120}]")),
        6,
        3,
        "did you mean fuji-2mbi300xbe120-50?",
    ),
    (
        "device-key",
        changed((f"operation.strategy: {_WORDS}", "inverter.device: [{nam: fuji}]")),
        6,
        3,
        "nam",
    ),
    (
        "file",
        changed((f"operation.strategy: {_WORDS}", "inverter.device: {files: [a.json]}")),
        6,
        3,
        "there is no file 'a.json'",
    ),
    (
        "files",
        changed((f"operation.strategy: {_WORDS}", "inverter.device: {files: d/*.xml}")),
        6,
        28,
        "no file beside the study is called 'd/*.xml'",
    ),
    (
        "files-far",
        changed((f"operation.strategy: {_WORDS}", "inverter.device: {files: ../*.xml}")),
        6,
        28,
        "outside the folder",
    ),
    ("files-of-number", changed((_RANGE, "{files: a.xml}")), 5, 34, "no file stands at this key"),
    (
        "in-step",
        changed(
            (_RANGE, "[60 kHz]"),
            (
                f"operation.strategy: {_WORDS}",
                "together: {inverter.dead_time: [1 us, 2 us], fit.segments: [1, 2, 3]}",
            ),
        ),
        6,
        48,
        "3 values in step with 2 of inverter.dead_time",
    ),
    (
        "grid",
        changed((_RANGE, _RANGE.replace("3}", "90000}")), (_DRAW, "draw: {count: 22000, seed: 1}")),
        4,
        1,
        "the grid has 4e9 rows; explore takes at most 1e8",
    ),
    (
        "whole",
        changed(
            (
                f"operation.strategy: {_WORDS}",
                "control.speed_loop.ratio: {range: {from: 1, to: 4, count: 3}}",
            )
        ),
        6,
        61,
        "2.5, which is no",
    ),
]

_DRAWN: list[Broken] = [
    (
        "list",
        changed(("inverter.v_dc:", "losses.strategies:")),
        11,
        3,
        "tolerances.losses.strategies: a list has no distribution; write values: [...] under vary",
    ),
    ("drawn-word", changed(("inverter.v_dc:", "inverter.topology:")), 11, 3, "a word has no"),
    ("drawn-whole", changed(("inverter.v_dc:", "fit.segments:")), 11, 3, "a whole number has no"),
    ("drawn-section", changed(("inverter.v_dc:", "inverter.device:")), 11, 3, "a section has no"),
    ("kinds", changed((_NORMAL, "{normal: 5 %, uniform: 1 %}")), 10, 3, "got normal and uniform"),
    ("gaussian", changed((_NORMAL, "{gauss: 5 %}")), 10, 24, "unknown key 'gauss'"),
    ("bare", changed((_NORMAL, "5 %")), 10, 23, "write {normal: 5 %}"),
    ("negative", changed((_NORMAL, "{normal: -5 %}")), 10, 32, "is negative"),
    ("zero", changed((_NORMAL, "{normal: 0 %}")), 10, 32, "nothing is drawn"),
    ("wrong-unit", changed((_NORMAL, "{normal: 1 mH}")), 10, 32, "expected a resistance"),
    ("huge", changed((_NORMAL, "{normal: 5000 %}")), 10, 32, "more than 1000 %"),
    ("comma-width", changed((_NORMAL, "{normal: '0,1 mOhm'}")), 10, 32, "write 0.1 mOhm"),
    ("cut", changed((_NORMAL, "{normal: 5 %, cut: 0}")), 10, 42, "expected 0.1 to 8"),
    ("cut-of-uniform", changed(("{uniform: 10 %}", "{uniform: 1 %, cut: 2}")), 11, 33, "normal"),
    ("between-one", changed((_NORMAL, "{between: 3 mOhm}")), 10, 33, "write [low, high]"),
    ("between-order", changed((_NORMAL, "{between: [3 mOhm, 2 mOhm]}")), 10, 33, "exchange them"),
    (
        "no-centre",
        changed(("machine.resistance", "machine.friction")),
        10,
        3,
        "machine.friction has no value in the design",
    ),
    (
        "no-box",
        changed(("  machine.resistance: {normal: 5 %}", "  design: uniform")),
        10,
        3,
        "the design has no control.tolerances",
    ),
    (
        "box-word",
        changed(("  machine.resistance: {normal: 5 %}", "  design: normal")),
        10,
        11,
        "expected uniform",
    ),
    (
        "tolerances-word",
        changed(
            (
                _DRAWN_KEYS,
                "tolerances: box",
            )
        ),
        9,
        13,
        "or the word design",
    ),
    ("no-draw", changed((_DRAW + "\n", "")), 9, 1, "write draw: {count: 100000, seed: 1}"),
    ("draw-count", changed(("count: 10,", "count: -10,")), 12, 15, "at least 1, got -10"),
    ("draw-none", changed(("count: 10,", "count: 0,")), 12, 15, "at least 1, got 0"),
    ("draw-part", changed(("count: 10,", "count: 1e5,")), 12, 15, "a whole number"),
    ("draw-many", changed(("count: 10,", "count: 900000000,")), 12, 15, "at most 1e+08"),
    ("no-seed", changed((", seed: 1}", "}")), 12, 1, "write seed: 1"),
    ("seed", changed(("seed: 1", "seed: -1")), 12, 25, "at least 0"),
    ("seed-text", changed(("seed: 1", "seed: one")), 12, 25, "a whole number"),
    ("sampling", changed(("seed: 1", "seed: 1, sampling: lhs")), 12, 38, "one of random, sobol"),
    (
        "correlated-with-none",
        changed(
            ("seed: 1", "seed: 1, correlations: [{keys: [inverter.v_dc, machine.poles], rho: 0.5}]")
        ),
        12,
        66,
        "'machine.poles' is not drawn",
    ),
    (
        "rho",
        changed(
            (
                "seed: 1",
                "seed: 1, correlations: [{keys: [inverter.v_dc, machine.resistance], rho: 1.5}]",
            )
        ),
        12,
        92,
        "less than 1",
    ),
    (
        "correlated-twice",
        changed(
            (
                "seed: 1",
                (
                    "seed: 1, correlations: [{keys: [inverter.v_dc, machine.resistance], "
                    "rho: 0.5}, {keys: [machine.resistance, inverter.v_dc], rho: 0.2}]"
                ),
            )
        ),
        12,
        105,
        "this pair is there twice",
    ),
]

_ASKED: list[Broken] = [
    ("limit-unit", changed(("900 W", "900 V")), 16, 17, "expected a power"),
    ("limit-list", changed(("900 W", "[900 W]")), 16, 17, "write {below: ...}"),
    ("bound-key", changed(("above: 60", "over: 60")), 14, 24, "unknown key 'over'"),
    ("bound-none", changed(("{above: 60 deg}", "{}")), 14, 23, "expected a mapping"),
    ("bound-empty", changed(("above: 60 deg", "above: 90 deg, below: 60 deg")), 14, 31, "exchange"),
    (
        "bound-point",
        changed(("above: 60 deg", "above: 60 deg, point: {torque: 1, speed: 1}")),
        14,
        39,
        "this output has no points",
    ),
    ("point", changed(("900 W", "{below: 900 W, point: {torque: 130 N m}}")), 16, 32, "'speed'"),
    (
        "point-unit",
        changed(("900 W", "{below: 900 W, point: {torque: 130 A, speed: 300 rad/s}}")),
        16,
        48,
        "a torque",
    ),
    (
        "point-word",
        changed(("900 W", "{below: 900 W, point: {torque: 1, speed: 3, modulation: svm}}")),
        16,
        73,
        "svpwm",
    ),
    ("goals", changed(("{minimise: [losses.total]}", "{}")), 17, 1, "needs minimise or maximise"),
    (
        "goal-twice",
        changed(
            ("{minimise: [losses.total]}", "{minimise: [losses.total], maximise: [losses.total]}")
        ),
        17,
        47,
        "there twice",
    ),
    ("american", changed(("minimise:", "minimize:")), 17, 10, "did you mean 'minimise'"),
    (
        "sensitivity-of-nothing",
        changed(
            (
                (f"{_DRAWN_KEYS}\n{_DRAW}\n"),
                "",
            )
        ),
        14,
        1,
        "write tolerances and draw",
    ),
    ("header", changed((_DRAW, f"{_DRAW}\nheader: out/demo")), 13, 9, "no folder 'out/demo'"),
    ("header-file", changed((_DRAW, f"{_DRAW}\nheader: ''")), 13, 9, "the text is empty"),
    ("search-draws", changed((_DRAW, f"{_DRAW}\nsearch: {{seed: 1}}")), 13, 1, "draws nothing"),
    ("search-words", BASE + "search: {method: nlop, seed: 1}\n", 19, 18, "did you mean 'nlopt'?"),
    ("search-seed", BASE + "search: {method: nsga2}\n", 19, 1, "write seed: 1"),
    (
        "search-goals",
        changed(("pareto: {minimise: [losses.total]}\n", "")) + "search: {seed: 1}\n",
        18,
        1,
        "needs goals; write pareto: {minimise: [...]}",
    ),
    (
        "search-two-goals",
        changed(("[losses.total]}", "[losses.total, fit.error.torque]}")) + _NLOPT,
        19,
        18,
        "nlopt has one goal, pareto has 2; write nsga2",
    ),
    (
        "search-listed",
        BASE + _NLOPT,
        19,
        18,
        "which operation.strategy is not; write a range, or nsga2",
    ),
    (
        "search-long",
        changed((f"{_DRAWN_KEYS}\n{_DRAW}\n", ""), ("sensitivity: [losses.total]\n", ""))
        + "search: {seed: 1, population: 100000, generations: 1001}\n",
        14,
        1,
        "the search has 100,100,000 rows; explore takes at most 1e8; write a smaller population",
    ),
]

BROKEN: list[Broken] = [*_FILE, *_KEYS, *_VALUES, *_DRAWN, *_ASKED]
