"""Design files with one fault each: (name, content, line, column, phrase that
the message must contain).

Plain data without imports from the package, so that tests of any layer can load it from its path.
Lines and columns were counted by hand in `BASE`; a phrase is what helps the reader, not the whole
message.
"""

from __future__ import annotations

BASE = """\
dqforge: 1
name: Bench motor
machine:
  model: linear
  pole_pairs: 3
  resistance: 2.35 Ohm
  inductance_d: 1.61 mH
  inductance_q: 1.74 mH
  magnet_flux: 0.06 Wb
  max_current: 6.4 A
  max_speed: 5420 rpm
  inertia: 200e-6 kg m^2
inverter:
  v_dc: 180 V
  switching_frequency: 5 kHz
  dead_time: 2 us
control:
  sampling_frequency: 5 kHz
  current_loop:
    method: bandwidth
    bandwidth: 200 Hz
  speed_loop:
    method: symmetrical-optimum
    ratio: 10
operation:
  strategy: mtpa
fit:
  form: torque-exact
  degree: 2
  segments: 2
export:
  prefix: bench
  vectors: 64
"""

# Lines to insert behind line 24, the last of the section control, or to replace others with.
_DEVICE = """\
  device:
    kind: mosfet
    on_resistance: 9.5 mOhm
    turn_on_energy: 1 mJ
    turn_off_energy: 1 mJ
    reference_current: 100 A
    reference_voltage: 300 V
    thermal_resistance: 0.3 K/W
"""


def changed(old: str, new: str) -> str:
    """Text of `BASE` with one line or phrase replaced; it must occur exactly once."""
    if BASE.count(old) != 1:
        raise ValueError(f"{old!r} does not occur exactly once")
    return BASE.replace(old, new)


def _flux(*lines: str) -> str:
    return changed("  magnet_flux: 0.06 Wb\n", "".join(f"  {line}\n" for line in lines))


def _rated(*lines: str) -> str:
    inertia = "  inertia: 200e-6 kg m^2\n"
    return changed(inertia, inertia + "  rated:\n" + "".join(f"    {line}\n" for line in lines))


def _fit(*lines: str) -> str:
    return changed("  segments: 2\n", "".join(f"  {line}\n" for line in lines))


def _losses(*lines: str) -> str:
    text = changed("control:\n", _DEVICE + "control:\n")
    return text + "losses:\n" + "".join(f"  {line}\n" for line in lines)


def _choice(*lines: str) -> str:
    text = changed("control:\n", _DEVICE + "control:\n") + "modulation_choice:\n"
    return text + "".join(
        f"  {line}\n" for line in ("min_frequency: 8 kHz", "max_frequency: 20 kHz", *lines)
    )


def _tolerances(*lines: str, speed: bool = True) -> str:
    text = changed(
        "    ratio: 10\n",
        "    ratio: 10\n  tolerances:\n" + "".join(f"    {line}\n" for line in lines),
    )
    return (
        text
        if speed
        else text.replace("  speed_loop:\n    method: symmetrical-optimum\n    ratio: 10\n", "")
    )


Broken = tuple[str, str | bytes, int, int, str]

_YAML: list[Broken] = [
    ("empty-file", b"", 1, 1, "the file is empty; 'dqforge new' writes one"),
    ("only-comments", "# to do\n", 1, 1, "the file is empty"),
    ("list-instead-of-mapping", "- machine\n- inverter\n", 1, 1, "the file holds a list"),
    ("bare-text", "machine\n", 1, 1, "the file holds the text 'machine'"),
    (
        "yaml-bomb",
        "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: [*c, *c]\n",
        1,
        4,
        "anchors ('&name') are not read",
    ),
    (
        "alias",
        changed("5420 rpm", "*speed"),
        11,
        14,
        "references ('*name') are not read; write the value itself",
    ),
    ("merge-key", BASE + "<<: {name: x}\n", 34, 1, "merge keys ('<<') are not read"),
    (
        "tag-python-object",
        changed("Bench motor", "!!python/object:os.system x"),
        2,
        7,
        "are not read; remove it",
    ),
    ("tag-own", changed("5420 rpm", "!speed 5420"), 11, 14, "tags such as '!speed' are not read"),
    ("two-documents", BASE + "---\n" + BASE, 34, 1, "write one design per file"),
    (
        "duplicate-key",
        changed("  max_speed:", "  max_current: 7 A\n  max_speed:"),
        11,
        3,
        "'max_current' is given twice, first in line 10, column 3",
    ),
    (
        "tab-indentation",
        changed("  model: linear", "\tmodel: linear"),
        4,
        1,
        "a tab is used for indentation",
    ),
    (
        "uneven-indentation",
        changed("  max_current: 6.4 A", " max_current: 6.4 A"),
        10,
        2,
        "does not line up",
    ),
    (
        "no-space-after-colon",
        changed("v_dc: 180 V", "v_dc:180 V"),
        15,
        22,
        "the space behind each ':'",
    ),
    ("second-colon", changed("180 V", "180 V: dc"), 14, 14, "or use quotes"),
    ("open-quote", changed("Bench motor", "'Bench motor"), 2, 7, "write the missing quote"),
    ("open-brace", changed("180 V", "{value: 180 V"), 14, 9, "'{' is not closed"),
    ("percent-sign-first", changed("6.4 A", "%5"), 10, 16, "must stand in quotes"),
    (
        "not-utf-8",
        BASE.encode().replace(b"Bench", b"B\xe4nch"),
        2,
        8,
        "0xE4 is not UTF-8; save the file",
    ),
    ("utf-16", BASE.encode("utf-16"), 1, 1, "not UTF-8"),
    (
        "nul-byte",
        BASE.encode().replace(b"6.4 A", b"6.4\x00A"),
        10,
        19,
        "U+0000 is not text; remove it",
    ),
    (
        "escape-character",
        BASE.encode().replace(b"6.4 A", b"6.4\x1bA"),
        10,
        19,
        "U+001B is not text",
    ),
    ("deep-nesting", "a: " + "[" * 5000, 1, 35, "nested deeper than 32 levels"),
    (
        "deep-mappings",
        "".join(f"{' ' * n}a:\n" for n in range(60)),
        33,
        33,
        "nested deeper than 32 levels",
    ),
    (
        "too-many-values",
        "a: [" + "1, " * 30000 + "1]\n",
        1,
        59996,
        "more than 20000 keys and values",
    ),
    (
        "number-too-large",
        changed("200e-6 kg m^2", "1e999"),
        12,
        12,
        "the number '1e999' is too large",
    ),
    ("number-too-long", changed("200e-6 kg m^2", "1" * 5000), 12, 12, "more than 40 digits"),
    ("key-is-list", BASE + "? [a]\n: 1\n", 34, 3, "a key must be a plain word"),
]

_STRUCTURE: list[Broken] = [
    ("missing-version", changed("dqforge: 1\n", ""), 1, 1, "write dqforge: 1"),
    (
        "other-version",
        changed("dqforge: 1", "dqforge: 2"),
        1,
        10,
        "version 1 of the format, got 2; write dqforge: 1",
    ),
    ("version-true", changed("dqforge: 1", "dqforge: true"), 1, 10, "got true; write dqforge: 1"),
    (
        "missing-name",
        changed("name: Bench motor\n", ""),
        1,
        1,
        "needs the key 'name'; write name: My first drive",
    ),
    (
        "missing-inverter",
        "dqforge: 1\nname: x\nmachine: {}\n",
        1,
        1,
        "the section 'inverter' is missing",
    ),
    (
        "missing-key",
        changed("  resistance: 2.35 Ohm\n", ""),
        3,
        1,
        "needs the key 'resistance'; write resistance:",
    ),
    ("missing-poles", changed("  pole_pairs: 3\n", ""), 3, 1, "write poles: 8 (or pole_pairs: 4)"),
    (
        "unknown-key",
        changed("  resistance:", "  resistence:"),
        6,
        3,
        "'resistence'; did you mean 'resistance'",
    ),
    ("symbol-as-key", changed("  inductance_d:", "  Ld:"), 7, 3, "did you mean 'inductance_d'?"),
    ("unknown-section", changed("inverter:\n", "converter:\n"), 13, 1, "did you mean 'inverter'?"),
    (
        "key-of-another-section",
        changed("  dead_time: 2 us\n", "  dead_time: 2 us\n  sampling_frequency: 5 kHz\n").replace(
            "control:\n  sampling_frequency: 5 kHz\n", "control:\n"
        ),
        17,
        3,
        "unknown key 'sampling_frequency'; it belongs in control, check the indentation",
    ),
    (
        "key-outdented",
        changed("  v_dc: 180 V\n", "").replace("name:", "v_dc: 180 V\nname:"),
        2,
        1,
        "belongs in inverter",
    ),
    ("bus-voltage", changed("  v_dc:", "  voltage:"), 14, 3, "did you mean 'v_dc'?"),
    ("stray-comma", changed("6.4 A", ", 6.4 A"), 10, 16, "stands where a value must"),
    ("nothing-like-it", BASE + "colour: red\n", 34, 1, "allowed: dqforge, name, about, machine"),
    (
        "unknown-key-of-value",
        changed("180 V", "{value: 180 V, unit: V}"),
        14,
        24,
        "unknown key 'unit'; allowed: value",
    ),
    (
        "value-missing",
        changed("180 V", "{source: label}"),
        14,
        9,
        "the key 'value' is missing; write value: 48 V",
    ),
    ("empty-value", changed("180 V", ""), 14, 3, "inverter.v_dc has no value"),
    (
        "empty-section",
        changed("  v_dc: 180 V\n  switching_frequency: 5 kHz\n  dead_time: 2 us\n", ""),
        13,
        1,
        "no value",
    ),
    ("section-is-number", BASE + "losses: 5\n", 34, 9, "expected a section with keys, got 5"),
    (
        "list-as-quantity",
        changed("180 V", "[180 V]"),
        14,
        9,
        "expected a voltage such as '48 V', got a list",
    ),
    (
        "true-as-quantity",
        changed("6.4 A", "true"),
        10,
        16,
        "expected a current such as '12 A', got true",
    ),
    (
        "quoted-count",
        changed("ratio: 10", "ratio: '10'"),
        24,
        12,
        "expected a whole number, got the text '10'",
    ),
    (
        "fractional-degree",
        changed("degree: 2", "degree: 2.5"),
        29,
        11,
        "expected a whole number, got 2.5",
    ),
    (
        "degree-too-high",
        changed("degree: 2", "degree: 9"),
        29,
        11,
        "expected a number of at most 6, got 9",
    ),
    ("yes-for-true", _fit("continuous: yes"), 30, 15, "expected true or false, got the text 'yes'"),
    (
        "unit-on-a-number",
        changed("    method: bandwidth\n", "    method: bandwidth\n    damping: 1 s\n"),
        21,
        14,
        "number",
    ),
    ("unknown-choice", changed("strategy: mtpa", "strategy: mpta"), 26, 13, "did you mean 'mtpa'?"),
    (
        "other-choice",
        changed("strategy: mtpa", "strategy: 3"),
        26,
        13,
        "expected one of mtpa, id0, got 3",
    ),
    ("other-model", changed("model: linear", "model: fluxmap"), 4, 10, "did you mean 'flux-map'?"),
    (
        "keys-of-another-model",
        changed("model: linear", "model: flux-map"),
        7,
        3,
        "belongs to the model 'linear'",
    ),
    (
        "name-is-number",
        changed("Bench motor", "42"),
        2,
        7,
        "expected a text, got 42; put it in quotes",
    ),
    ("name-empty", changed("Bench motor", "''"), 2, 7, "the text is empty"),
    (
        "name-ends-comment",
        changed("Bench motor", "Bench */ motor"),
        2,
        7,
        "'*/', which C reads as code",
    ),
    (
        "name-line-comment",
        changed("Bench motor", "Bench // motor"),
        2,
        7,
        "'//', which C reads as code",
    ),
    ("name-trigraph", changed("Bench motor", '"Bench??/"'), 2, 7, "'??', which C reads as code"),
    ("name-backslash", changed("Bench motor", "'Bench \\'"), 2, 7, "ends with a backslash"),
    ("name-escape", changed("Bench motor", '"B\\e[31m"'), 2, 7, "invisible character U+001B"),
    (
        "name-right-to-left",
        changed("Bench motor", '"B\\u202emotor"'),
        2,
        7,
        "invisible character U+202E",
    ),
    ("name-too-long", changed("Bench motor", "x" * 81), 2, 7, "81 characters; write at most 80"),
    (
        "note-ends-comment",
        changed("180 V", "{value: 180 V, note: a */ b}"),
        14,
        30,
        "'*/', which C reads as code",
    ),
    (
        "inferred-is-text",
        changed("180 V", "{value: 180 V, inferred: maybe}"),
        14,
        34,
        "expected true or false",
    ),
    (
        "source-is-number",
        changed("180 V", "{value: 180 V, source: 7}"),
        14,
        32,
        "expected a text, got 7",
    ),
    (
        "prefix-starts-with-digit",
        changed("prefix: bench", "prefix: 3phase"),
        32,
        11,
        "write e.g. phase",
    ),
    (
        "prefix-with-dash",
        changed("prefix: bench", "prefix: my-motor"),
        32,
        11,
        "write e.g. my_motor",
    ),
    (
        "prefix-not-ascii",
        changed("prefix: bench", "prefix: Motör"),
        32,
        11,
        "not an identifier in C",
    ),
    (
        "prefix-keyword",
        changed("prefix: bench", "prefix: register"),
        32,
        11,
        "is a word of C or C++",
    ),
    (
        "prefix-cpp-keyword",
        changed("prefix: bench", "prefix: namespace"),
        32,
        11,
        "write e.g. namespace1",
    ),
    ("prefix-underscore", changed("prefix: bench", "prefix: _bench"), 32, 11, "write e.g. bench"),
    ("prefix-two-underscores", changed("prefix: bench", "prefix: a__b"), 32, 11, "write e.g. a_b"),
    ("prefix-too-long", changed("prefix: bench", "prefix: " + "a" * 32), 32, 11, "at most 31"),
    ("too-few-vectors", changed("vectors: 64", "vectors: 3"), 33, 12, "at least 16, got 3"),
    (
        "q-format-short",
        changed("200 Hz", "200 Hz\n    q_formats: [10]"),
        22,
        16,
        "entry 2 is missing",
    ),
    (
        "q-format-large",
        changed("200 Hz", "200 Hz\n    q_formats: [10, 99]"),
        22,
        21,
        "at most 31, got 99",
    ),
]

_UNITS: list[Broken] = [
    (
        "wrong-unit",
        changed("1.61 mH", "5 kHz"),
        7,
        17,
        "expected an inductance such as '1.61 mH', got '5 kHz' which is a fre",
    ),
    (
        "unknown-unit",
        changed("1.61 mH", "1.61 furlong"),
        7,
        17,
        "unknown unit 'furlong', expected an inductance",
    ),
    ("unit-case", changed("1.61 mH", "1.61 mh"), 7, 17, "did you mean 'mH'?"),
    (
        "unit-case-frequency",
        changed("switching_frequency: 5 kHz", "switching_frequency: 5 KHz"),
        15,
        24,
        "'kHz'?",
    ),
    ("german-comma", changed("1.61 mH", "1,61 mH"), 7, 17, "write 1.61 mH"),
    ("thousands", changed("5420 rpm", "5,420 rpm"), 11, 14, "write 5420 rpm, or 5.420 rpm"),
    ("infinite", changed("1.61 mH", ".inf"), 7, 17, "'.inf' is not a finite number"),
    (
        "not-a-number",
        changed("1.61 mH", "about 2 mH"),
        7,
        17,
        "'about 2 mH' is not a number with a unit",
    ),
    ("unit-alone", changed("1.61 mH", "mH"), 7, 17, "has a unit but no number"),
    ("power-tower", changed("1.61 mH", "1.61 mH**999999999"), 7, 17, "is not a unit"),
    ("code-as-unit", changed("1.61 mH", "__import__('os')"), 7, 17, "is not a number with a unit"),
    (
        "ambiguous-unit",
        changed("200e-6 kg m^2", "2 N m/rad s"),
        12,
        12,
        "write N m/(rad s) with parentheses",
    ),
    ("speed-in-hertz", changed("5420 rpm", "90 Hz"), 11, 14, "write it with rpm or rad/s"),
    (
        "frequency-in-rpm",
        changed("switching_frequency: 5 kHz", "switching_frequency: 5 rpm"),
        15,
        24,
        "write it in Hz",
    ),
    (
        "bare-inductance",
        changed("1.61 mH", "350"),
        7,
        17,
        "did you forget the unit? write e.g. '350 uH'",
    ),
    (
        "bare-resistance",
        changed("2.35 Ohm", "2350"),
        6,
        15,
        "did you forget the unit? write e.g. '2350 mOhm'",
    ),
    (
        "bare-margin",
        changed("200 Hz", "200 Hz\n    min_phase_margin: 30"),
        22,
        23,
        "write e.g. '30 deg'",
    ),
    (
        "implausible-unit",
        changed("2.35 Ohm", "2.35 MOhm"),
        6,
        15,
        "outside 1 uOhm to 1 kOhm; check the number and its",
    ),
    ("negative-inductance", changed("1.61 mH", "-1.61 mH"), 7, 17, "must be positive"),
    ("negative-flux", changed("0.06 Wb", "-0.06 Wb"), 9, 16, "must be zero or positive"),
    ("zero-voltage", changed("180 V", "0 V"), 14, 9, "must be positive"),
    (
        "too-many-pole-pairs",
        changed("pole_pairs: 3", "pole_pairs: 3000"),
        5,
        15,
        "outside 1 to 200",
    ),
    (
        "fractional-pole-pairs",
        changed("pole_pairs: 3", "pole_pairs: 3.5"),
        5,
        15,
        "expected a whole number such as 4",
    ),
    (
        "kind-missing",
        _flux("back_emf_constant: 12 V/krpm"),
        9,
        22,
        "write '12 V/krpm phase peak', or phase rms",
    ),
    (
        "kind-unknown",
        changed("2.35 Ohm", "{value: 2.35 Ohm, kind: star}"),
        6,
        39,
        "expected one of phase, line-to-line",
    ),
    ("kind-misspelt", changed("6.4 A", "{value: 6.4 A, kind: rsm}"), 10, 37, "did you mean 'rms'?"),
    (
        "kind-not-wanted",
        changed("180 V", "{value: 180 V, kind: peak}"),
        14,
        24,
        "unknown key 'kind'",
    ),
]

_CONTRADICTIONS: list[Broken] = [
    ("odd-poles", changed("pole_pairs: 3", "poles: 3"), 5, 10, "write pole_pairs: 3"),
    (
        "poles-and-pairs",
        changed("pole_pairs: 3", "pole_pairs: 3\n  poles: 8"),
        6,
        10,
        "means 4 pole pairs, but pole_pairs",
    ),
    (
        "poles-given-as-pairs",
        # psi = 0.06 Wb and 3 pole pairs make 0.18 V s/rad; with 6 in place of 3 it implies 0.03 Wb.
        _flux(
            "magnet_flux: 0.06 Wb", "back_emf_constant: {value: 0.18 V s/rad, kind: phase peak}"
        ).replace("pole_pairs: 3", "pole_pairs: 6"),
        10,
        22,
        "pole_pairs 6 looks like the number of poles; write poles: 6",
    ),
    (
        "line-to-line-given-as-phase",
        _flux(
            "magnet_flux: 0.06 Wb", "back_emf_constant: {value: 0.311769 V s/rad, kind: phase peak}"
        ),
        10,
        22,
        "by the factor 1.73; a line-to-line value given as phase",
    ),
    (
        "rms-given-as-peak",
        # 3/2 p psi = 0.27 N m per ampere peak, 0.3818 per ampere r.m.s.
        _flux("magnet_flux: 0.06 Wb", "torque_constant: {value: 0.3818 N m/A, kind: peak}"),
        10,
        20,
        "an r.m.s. value given as peak",
    ),
    (
        "constants-unrelated",
        _flux("magnet_flux: 0.06 Wb", "torque_constant: {value: 0.6 N m/A, kind: peak}"),
        10,
        20,
        "implies psi_pm = 0.1333 Wb",
    ),
    (
        "no-flux-at-all",
        changed("  magnet_flux: 0.06 Wb\n", ""),
        3,
        1,
        "write e.g. magnet_flux: 0.06 Wb",
    ),
    (
        "no-torque",
        changed("1.74 mH", "1.61 mH").replace("0.06 Wb", "0 Wb"),
        8,
        17,
        "it gives no torque; write magnet_flux or two different inductances",
    ),
    # 3 pairs at 1000 rpm turn the field at 50 Hz; 25 Hz belong to 1.5 pairs, 100 Hz to 6.
    (
        "rated-frequency",
        _rated("speed: 1000 rpm", "frequency: 100 Hz"),
        15,
        16,
        "write pole_pairs: 6",
    ),
    (
        "rated-frequency-slip",
        _rated("speed: 1000 rpm", "frequency: 57 Hz"),
        15,
        16,
        "asynchronous machine has slip",
    ),
    (
        "rated-frequency-poles",
        _rated("speed: 1000 rpm", "frequency: 50 Hz").replace("pole_pairs: 3", "pole_pairs: 6"),
        15,
        16,
        "pole_pairs 6 looks like the number of poles; write poles: 6",
    ),
    (
        "rated-power",
        _rated("torque: 0.47 N m", "speed: 5420 rpm", "power: 1 kW"),
        16,
        12,
        "times rated.speed 5420 rpm is 266.76 W",
    ),
    ("rated-torque", _rated("torque: 4.7 N m"), 14, 13, "check the kind of max_current"),
    ("rated-current", _rated("current: 9 A"), 14, 14, "check the kinds (peak or rms)"),
    ("rated-speed", _rated("speed: 9000 rpm"), 14, 12, "above max_speed"),
    (
        "dead-time",
        changed("2 us", "100 us"),
        16,
        14,
        "not shorter than half a switching period, 100 us",
    ),
    ("dead-time-bare", changed("2 us", "2"), 16, 14, "write e.g. '2 us'"),
    (
        "sampling",
        changed("sampling_frequency: 5 kHz", "sampling_frequency: 50 kHz"),
        18,
        23,
        "write 500 Hz to 10 kHz",
    ),
    (
        "bandwidth-missing",
        changed("    bandwidth: 200 Hz\n", ""),
        20,
        13,
        "needs the key 'bandwidth'; write bandwidth:",
    ),
    (
        "gain-missing",
        changed("    bandwidth: 200 Hz\n", "").replace("d: bandwidth", "d: given"),
        20,
        13,
        "the key 'kp'",
    ),
    (
        "bandwidth-not-used",
        changed("method: bandwidth", "method: magnitude-optimum"),
        21,
        5,
        "does not use 'bandwidth'; write method: bandwidth",
    ),
    ("inertia-missing", changed("  inertia: 200e-6 kg m^2\n", ""), 21, 3, "write machine.inertia"),
    (
        "observer-without-magnets",
        changed("operation:", "  observer: {pole: 400 rad/s}\noperation:").replace(
            "0.06 Wb", "0 Wb"
        ),
        25,
        3,
        "needs a magnet flux",
    ),
    (
        "observer-pole-missing",
        changed("operation:", "  observer: {bandwidth: 400 rad/s}\noperation:"),
        25,
        3,
        "needs the key 'pole'; write pole: 400 rad/s",
    ),
    (
        "observer-key-not-used",
        changed("operation:", "  observer: {method: extended-emf, speed_gain: 0.2}\noperation:"),
        25,
        36,
        "does not use 'speed_gain'",
    ),
    (
        "id0-without-magnets",
        changed("0.06 Wb", "0 Wb").replace("mtpa", "id0"),
        26,
        13,
        "write strategy: mtpa",
    ),
    (
        "closed-form-without-saliency",
        changed("torque-exact", "closed-form").replace("1.74 mH", "1.61 mH"),
        28,
        9,
        "write form: torque-exact",
    ),
    (
        "breakpoints-count",
        _fit("segments: 3", "breakpoints: [0.5 N m]"),
        31,
        16,
        "write segments: 2, or 2 breakpoints",
    ),
    ("breakpoints-order", _fit("segments: 3", "breakpoints: [1 N m, 0.5 N m]"), 31, 24, "in order"),
    (
        "breakpoints-outside",
        _fit("segments: 2", "max_torque: 1 N m", "breakpoints: [2 N m]"),
        32,
        17,
        "beyond the end",
    ),
    (
        "breakpoints-current-limit",
        _fit("segments: 2", "breakpoints: [2 N m]"),
        31,
        17,
        "end of the domain, 1.7282 N m",
    ),
    (
        "speed-base-unknown",
        changed("0.06 Wb", "0 Wb")
        .replace("  max_speed: 5420 rpm\n", "")
        .replace("torque-exact", "closed-form"),
        3,
        1,
        "write max_speed: 3000 rpm",
    ),
    (
        "form-without-magnet",
        changed("0.06 Wb", "0 Wb"),
        28,
        9,
        "torque-exact divides by the magnet torque",
    ),
    (
        "losses-without-device",
        BASE + "losses:\n  points: [{torque: 1, speed: 9}]\n",
        34,
        1,
        "inverter.device",
    ),
    ("losses-without-points", _losses("points: []"), 43, 11, "a list of at least 1, got 0"),
    (
        "losses-point-unit",
        _losses("points: [{torque: 1 N m, speed: 5 m}]"),
        43,
        35,
        "expected a rotational speed",
    ),
    (
        "losses-point-key",
        _losses("points: [{torque: 1 N m, omega: 5}]"),
        43,
        28,
        "did you mean 'speed'?",
    ),
    ("losses-speed", _losses("points: [{torque: 1 N m, speed: 1500}]"), 43, 35, "write '1500 rpm'"),
    (
        "losses-twice",
        _losses("points: [{torque: 1, speed: 9}]", "strategies: [id0, id0]"),
        44,
        21,
        "listed twice",
    ),
    (
        "losses-modulation",
        _losses("points: [{torque: 1, speed: 9}]", "modulations: [svm]"),
        44,
        17,
        "did you mean 'svpwm'",
    ),
]

_CHOICE: list[Broken] = [
    (
        "choice-without-device",
        BASE + "modulation_choice: {min_frequency: 8 kHz, max_frequency: 20 kHz}\n",
        34,
        1,
        "write the section inverter.device",
    ),
    (
        "choice-without-range",
        changed("control:\n", _DEVICE + "control:\n")
        + "modulation_choice:\n  min_frequency: 8 kHz\n",
        42,
        1,
        "write max_frequency: 20 kHz",
    ),
    (
        "choice-range",
        _choice().replace("max_frequency: 20 kHz", "max_frequency: 2 kHz"),
        44,
        18,
        "2 kHz lies below min_frequency 8 kHz; exchange them",
    ),
    ("choice-range-unit", _choice().replace("20 kHz", "20 V"), 44, 18, "expected a frequency"),
    ("choice-modulators", _choice("modulations: [svpwm, dpwm]"), 45, 24, "did you mean"),
    (
        "choice-modulator-twice",
        _choice("modulations: [svpwm, svpwm]"),
        45,
        24,
        "'svpwm' is listed twice",
    ),
    (
        "choice-band",
        _choice("avoid: [{min: 12 kHz, max: 10 kHz}]"),
        45,
        30,
        "does not lie above min 12 kHz",
    ),
    (
        "choice-band-all",
        _choice("avoid: [{min: 1 kHz, max: 50 kHz}]"),
        45,
        17,
        "leaves nothing from 8 kHz to 20 kHz",
    ),
    (
        "choice-ripple-twice",
        _choice("ripple_current: 1 A", "ripple_share: 5 %"),
        46,
        3,
        "ripple_current and ripple_share say the same",
    ),
    ("choice-ripple-none", _choice("ripple_share: 0 %"), 45, 17, "no inverter is without ripple"),
    (
        "choice-speed",
        _choice("speed: 9000 rpm"),
        45,
        10,
        "9000 rpm is above machine.max_speed 5420 rpm",
    ),
    (
        "choice-no-speed",
        _choice().replace("  max_speed: 5420 rpm\n", ""),
        41,
        1,
        "the largest speed is unknown; write speed: 6000 rpm here",
    ),
    ("choice-questions", _choice("questions: 5"), 45, 14, "at most 2"),
    ("choice-grid", _choice("torques: 1"), 45, 12, "at least 2"),
    ("choice-key", _choice("ripple: 1 A"), 45, 3, "unknown key 'ripple'"),
    (
        "choice-hot",
        _choice("max_junction_temperature: 400 degC"),
        45,
        29,
        "max_junction_temperature",
    ),
]

_LOOPS: list[Broken] = [
    ("tolerance-too-large", _tolerances("l_q: 95 %"), 26, 10, "'95 %' is outside 0 % to 90 %"),
    ("tolerance-bare", _tolerances("l_q: 20"), 26, 10, "'20' is outside 0 % to 90 %"),
    ("tolerance-unknown", _tolerances("resistance: 20 %"), 26, 5, "unknown key 'resistance'"),
    ("tolerance-unit", _tolerances("r_s: 0.2 Ohm"), 26, 10, "Ohm"),
    (
        "tolerance-dead-time-bare",
        _tolerances("dead_time: 0.2"),
        26,
        16,
        "such as '20 %' or a time such as '0.2 us'",
    ),
    ("tolerance-dead-time-long", _tolerances("dead_time: 20 us"), 26, 16, "outside 0 s to 10 us"),
    (
        "tolerance-of-no-dead-time",
        _tolerances("dead_time: 20 %").replace("  dead_time: 2 us\n", ""),
        25,
        16,
        "which is 0; write inverter.dead_time",
    ),
    ("tolerance-low-current-alone", _tolerances("low_current: 1 A"), 26, 5, "goes with dead_time"),
    (
        "tolerance-low-current-high",
        _tolerances("dead_time: 20 %", "low_current: 9 A"),
        27,
        18,
        "above the current limit 6.4 A peak",
    ),
    (
        "tolerance-inertia-alone",
        _tolerances("inertia: 20 %", speed=False),
        23,
        5,
        "the speed loop alone",
    ),
    (
        "schedule-of-constants",
        changed("    bandwidth: 200 Hz\n", "    bandwidth: 200 Hz\n    schedule: true\n"),
        22,
        15,
        "the machine's inductances are constant",
    ),
    (
        "sensitivity-of-another-method",
        changed("    bandwidth: 200 Hz\n", "    bandwidth: 200 Hz\n    max_sensitivity: 1.5\n"),
        22,
        5,
        "does not use 'max_sensitivity'; write method: optimised",
    ),
    (
        "sensitivity-too-small",
        changed("    ratio: 10\n", "    ratio: 10\n    max_sensitivity: 1.0\n"),
        25,
        22,
        "max_sensitivity",
    ),
    (
        "optimised-bandwidth",
        changed("method: bandwidth", "method: optimised"),
        21,
        5,
        "does not use 'bandwidth'",
    ),
]

BROKEN: list[Broken] = [*_YAML, *_STRUCTURE, *_UNITS, *_CONTRADICTIONS, *_CHOICE, *_LOOPS]
