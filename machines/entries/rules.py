"""Entries of a design file: how a key's value is written, what it may be,
and what is said when it is not.

An entry is a number, a text with a unit, or a mapping with the keys ``value``, ``kind`` (where
conventions differ), ``source``, ``inferred`` and ``note``.
"""

from __future__ import annotations

import math
import re
import unicodedata
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, get_args

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.names import Firmware, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity, parse_quantity, read_quantity
from dqforge.machines.units.registry import (
    DIMENSIONS,
    USUAL_UNITS,
    KindWords,
    kind_words,
    words_pattern,
)

_ORIGIN_KEYS = ("source", "inferred", "note")


class EntryError(ValueError):
    """An entry is wrong.

    ``key`` is the part of its mapping that is at fault, or None for all of it.
    """

    def __init__(self, message: str, key: str | None = None, *, at_key: bool = False) -> None:
        self.message = message
        self.key = key
        self.at_key = at_key
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Quantity:
    """An entry as it was read: `si` in `unit`, the `text` of the file, and where it comes from.

    `kind` is the convention (``line-to-line``), `kind_given` whether the file names it beside the
    value or within its text, which then stands in `text` without it; `inverted` says that the file
    has the reciprocal. `dimension` is the key of its dimension, `bare` says that
    the file has no unit, and `remark` what a unit was taken for that leaves it open.
    """

    si: float
    unit: str
    text: str
    kind: str | None = None
    kind_given: bool = False
    inverted: bool = False
    source: str = ""
    inferred: bool = False
    note: str = ""
    dimension: str = ""
    bare: bool = False
    remark: str = ""


class Rule(ABC):
    """How one kind of entry is read; usable as annotation of a pydantic field."""

    __slots__ = ()

    @abstractmethod
    def read(self, raw: object) -> Quantity:
        """Entry for a value from the file; raises `EntryError` when it is wrong."""

    @abstractmethod
    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of the entry."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return self.json_schema()


@dataclass(frozen=True, slots=True)
class QuantityRule(Rule):
    """What one key accepts.

    Args:
        dimension: Key of `dqforge.machines.units.registry.DIMENSIONS`.
        low, high: Plausible values in the dimension's unit. What lies outside is refused, because
            it is nearly always a forgotten unit.
        kinds: Conventions to choose from.
        default_kind: The convention if none is named; None when one must be.
        zero: Whether zero is accepted although `low` is greater.
        kind_open: Whether a value may leave its kind open where none is the default.
    """

    dimension: str
    low: float
    high: float
    kinds: tuple[str, ...] = ()
    default_kind: str | None = None
    zero: bool = False
    kind_open: bool = False

    def read(self, raw: object) -> Quantity:
        """Entry for a value from the file.

        Raises:
            EntryError: The value is not a quantity of this dimension, not plausible, or its mapping
                has unknown keys.
        """
        entry = raw if isinstance(raw, dict) else {"value": raw}
        self._check_keys(entry)
        value = entry["value"]
        wanted = DIMENSIONS[self.dimension]
        if isinstance(value, bool) or not isinstance(value, (int, float, str)):
            got = (
                "a list"
                if isinstance(value, list)
                else "a mapping"
                if isinstance(value, dict)
                else spoken(value)
            )
            raise EntryError(
                f"expected {wanted.name} such as '{wanted.example}', got {got}", "value"
            )
        try:
            reading = read_quantity(value, self.dimension, kinds=bool(self.kinds))
        except InputError as error:
            raise EntryError(error.message, "value") from None
        self._check_plausible(reading.si, reading.text, bare=reading.bare)
        kind = self._kind_said(entry, reading.kind, reading.text)
        source, inferred, note = _origin(entry)
        return Quantity(
            reading.si,
            wanted.unit,
            reading.text,
            kind or self._kind_by_custom(reading.text, bare=reading.bare),
            kind is not None,
            reading.inverted,
            source,
            inferred,
            note,
            self.dimension,
            reading.bare,
            reading.remark,
        )

    def _check_keys(self, entry: dict[str, object]) -> None:
        allowed = ("value", *(("kind",) if self.kinds else ()), *_ORIGIN_KEYS)
        for key in entry:
            if key not in allowed:
                raise EntryError(unknown_key(key, allowed), key, at_key=True)
        if "value" not in entry:
            example = DIMENSIONS[self.dimension].example
            raise EntryError(f"the key 'value' is missing; write value: {example}")

    def _check_plausible(self, si: float, text: str, *, bare: bool) -> None:
        unit = DIMENSIONS[self.dimension].unit
        if self.low <= si <= self.high or (self.zero and si == 0.0):
            return
        if si <= 0.0 <= self.low and not (self.zero and si == 0.0):
            least = "zero or positive" if self.zero or self.low == 0.0 else "positive"
            turned = text.strip().removeprefix("-")
            other = si < 0.0 and self.low <= -si <= self.high
            meant = turned if other else DIMENSIONS[self.dimension].example
            raise EntryError(
                f"{shown(text)} must be {least}; write {'' if other else 'e.g. '}'{meant}'", "value"
            )
        # people who write a share in per cent, or mean to, find the limits in per cent
        percent = not unit and self.high <= 1.0 and (text.endswith("%") or 1.0 < si <= 100.0)
        shown_unit = "%" if percent else unit
        limits = (
            f"{format_quantity(self.low, shown_unit)} to {format_quantity(self.high, shown_unit)}"
        )
        if not bare or not unit:
            raise EntryError(
                f"{shown(text)} is outside {limits}; check the number and its unit", "value"
            )
        advice = self._advice(text)
        raise EntryError(
            f"{text} {unit} is outside {limits}: a bare number is in {unit}, did you forget the "
            f"unit? {advice}",
            "value",
        )

    def _advice(self, text: str) -> str:
        usual = USUAL_UNITS.get(self.dimension, ((), 0.0, 0.0))[0]
        for unit in usual:
            if self.low <= parse_quantity(f"{text} {unit}", self.dimension) <= self.high:
                return f"write e.g. '{text} {unit}'"
        return f"write e.g. '{DIMENSIONS[self.dimension].example}'"

    def _kind_said(
        self, entry: dict[str, object], words: KindWords | None, text: str
    ) -> str | None:
        """The kind that the text of an entry or its key ``kind`` names."""
        if not self.kinds:
            return None
        choice = KindChoice(self.kinds, DIMENSIONS[self.dimension].places)
        said = [] if words is None else [words]
        named = entry.get("kind")
        if "kind" in entry and not isinstance(named, str):
            raise EntryError(not_one_of(named, self.kinds), "kind")
        try:
            said += [choice.named(named)] if isinstance(named, str) else []
            return choice.meant(said, text)
        except InputError as error:
            raise EntryError(error.message, "kind" if "kind" in entry else "value") from None

    def _kind_by_custom(self, text: str, *, bare: bool) -> str | None:
        """The kind of a value whose file does not name it."""
        if not self.kinds or self.kind_open or self.default_kind is not None:
            return self.default_kind
        one, *others = self.kinds
        text = f"{text} {DIMENSIONS[self.dimension].unit}" if bare else text
        raise EntryError(
            f"the kind is missing (data sheets differ); write '{text} {one}', or "
            f"{', '.join(others)} in its place"
        )

    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of an entry: number, text or mapping."""
        wanted = DIMENSIONS[self.dimension]
        properties: dict[str, Any] = {
            "value": {
                "type": ["number", "string"],
                "description": f"{wanted.name}, such as '{wanted.example}'",
            }
        }
        required = ["value"]
        text = wanted.example
        if self.kinds:
            properties["kind"] = any_word_of(self.kinds) | {
                "description": f"one of {', '.join(self.kinds)}; may stand in the text"
            }
            if self.default_kind is not None:
                properties["kind"]["default"] = self.default_kind
            text = f"{text} {self.kinds[-1]}"
        numbers = [{"type": "number"}] if self.default_kind or not self.kinds else []
        choices = [*numbers, {"type": "string"}, _mapping_schema(properties, required)]
        return {"anyOf": choices, "examples": list(dict.fromkeys((wanted.example, text)))}


@dataclass(frozen=True, slots=True)
class CountRule(Rule):
    """A whole number of things, which may carry its origin like a quantity."""

    low: int
    high: int
    example: int

    def read(self, raw: object) -> Quantity:
        """Entry for a value from the file.

        Raises `EntryError` when it is not a whole number in the range.
        """
        entry = raw if isinstance(raw, dict) else {"value": raw}
        for key in entry:
            if key not in ("value", *_ORIGIN_KEYS):
                raise EntryError(unknown_key(key, ("value", *_ORIGIN_KEYS)), key, at_key=True)
        value = entry.get("value")
        if isinstance(value, bool) or not isinstance(value, int):
            raise EntryError(
                f"expected a whole number such as {self.example}, got {spoken(value)}", "value"
            )
        if not self.low <= value <= self.high:
            raise EntryError(
                f"{value} is outside {self.low} to {self.high}; write e.g. {self.example}", "value"
            )
        source, inferred, note = _origin(entry)
        return Quantity(float(value), "", str(value), source=source, inferred=inferred, note=note)

    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of an entry: whole number or mapping."""
        number = {"type": "integer", "minimum": self.low, "maximum": self.high}
        return {"anyOf": [number, _mapping_schema({"value": number}, ["value"])]}


def _mapping_schema(properties: dict[str, Any], required: list[str]) -> dict[str, Any]:
    origin = {
        "source": {"type": "string", "description": "where the value comes from"},
        "inferred": {
            "type": "boolean",
            "default": False,
            "description": "deduced, not stated by the source",
        },
        "note": {"type": "string", "description": "how it was deduced or measured"},
    }
    return {
        "type": "object",
        "properties": properties | origin,
        "required": required,
        "additionalProperties": False,
    }


def _origin(entry: dict[str, object]) -> tuple[str, bool, str]:
    """Source, inferred and note of an entry's mapping."""
    inferred = entry.get("inferred", False)
    if not isinstance(inferred, bool):
        raise EntryError(f"expected true or false, got {spoken(inferred)}", "inferred")
    texts = []
    for key in ("source", "note"):
        text = entry.get(key, "")
        if not isinstance(text, str):
            raise EntryError(f"expected a text, got {spoken(text)}; put it in quotes", key)
        try:
            # Addresses of web pages contain "//", so it is allowed where nothing becomes code.
            texts.append(plain_text(text, limit=500, slashes=True))
        except EntryError as error:
            raise EntryError(error.message, key) from None
    return texts[0], inferred, texts[1]


def plain_text(text: str, *, limit: int, slashes: bool = False) -> str:
    """Text that cannot end or start a comment in C; line breaks become spaces.

    Raises:
        EntryError: The text is too long or holds a character sequence that means something to a C
            compiler.
    """
    joined = " ".join(text.split())
    if len(joined) > limit:
        raise EntryError(f"the text has {len(joined)} characters; write at most {limit}")
    forbidden = ("*/", "/*", "??") + (() if slashes else ("//",))
    for sequence in forbidden:
        if sequence in joined:
            raise EntryError(
                f"the text contains {sequence!r}, which C reads as code; write it without"
            )
    if joined.endswith("\\"):
        raise EntryError(
            "the text ends with a backslash, which continues a line in C; write it without"
        )
    for character in joined:
        if not character.isprintable():
            raise EntryError(
                f"the text contains the invisible character U+{ord(character):04X}; remove it"
            )
    return joined


def not_truth(value: object) -> object:
    """Return the value unless it is true or false, which Python takes for 1 and 0."""
    if isinstance(value, bool):
        raise EntryError(f"expected a number, got {spoken(value)}")
    return value


def byte_count(value: object) -> object:
    """A number of bytes from a text such as "256 B" or "2 KiB"; other values as they are."""
    match = (
        re.fullmatch(r"\s*(\d{1,6})\s*(B|bytes?|KiB|kB)\s*", value)
        if isinstance(value, str)
        else None
    )
    if match is None:
        return not_truth(value)
    factor = {"K": 1024, "k": 1000}.get(match[2][0], 1)
    return factor * int(match[1])


def number_formats(value: object) -> object:
    """A list of one entry for the name of a number format; other values as they are."""
    if not isinstance(value, str):
        return value
    if value not in get_args(NumberFormat):
        raise EntryError(not_one_of(value, get_args(NumberFormat)))
    return [value]


def in_other_words(value: object, names: tuple[str, ...], words: Mapping[str, str]) -> object:
    """One of the names for a text that says it in other words; other values as they are.

    ``words`` are in small letters, for what is no place of `dqforge.machines.units.registry`.
    """
    if not isinstance(value, str):
        return value
    known = dict(words) | {name: name for name in names}
    if (found := known.get(value.strip().casefold())) is not None:
        return found
    try:
        said = kind_words(value)
        meant = None if said is None else KindChoice(names, words).meant([said])
    except InputError:
        return value
    return value if meant is None else meant


def any_word_of(names: tuple[str, ...], pattern: str = "") -> dict[str, Any]:
    """JSON Schema of a name that may be said in other words: editors offer the names.

    ``pattern`` is that of the words, unless they are those of kinds.
    """
    words = {"type": "string", "pattern": pattern or words_pattern()}
    return {"anyOf": [{"enum": list(names)}, words]}


def firmware_names(value: object) -> object:
    """A list of one entry for the name of a firmware; other values as they are."""
    if not isinstance(value, str):
        return value
    name = value.casefold()
    if name not in get_args(Firmware):
        raise EntryError(not_one_of(value, get_args(Firmware)))
    return [name]


def auto_or(value: object, otherwise: Callable[[object], object]) -> object:
    """The word auto as it is; other values as the schema has them."""
    return value if value == "auto" else otherwise(value)


def spoken(value: object) -> str:
    """Value from a YAML file as it is named in a message."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "a mapping"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.12g}"
    return f"the text {shown(value)}" if isinstance(value, str) else shown(value)[1:-1]


def unknown_key(key: str, allowed: tuple[str, ...], synonyms: dict[str, str] | None = None) -> str:
    """Message on a key that the section does not know, with the key that was probably meant."""
    meant = (synonyms or {}).get(key.casefold())
    matches = [meant] if meant in allowed else close_matches(key.replace("-", "_"), allowed)
    hint = (
        f"did you mean {' or '.join(repr(m) for m in matches)}?"
        if matches
        else f"allowed: {', '.join(allowed)}"
    )
    return f"unknown key {shown(key)}; {hint}"


def not_one_of(value: object, choices: tuple[object, ...]) -> str:
    """Message on a value that is none of the choices, with the one that was probably meant."""
    names = [str(choice) for choice in choices]
    matches = close_matches(value, names, limit=1) if isinstance(value, str) else []
    hint = f"; did you mean '{matches[0]}'?" if matches else ""
    expected = names[0] if len(names) == 1 else f"one of {', '.join(names)}"
    return f"expected {expected}, got {spoken(value)}{hint}"


def si_of(quantity: Quantity | None) -> float | None:
    """SI value of an optional entry."""
    return None if quantity is None else quantity.si


# Names of headers that a written header would shadow, since a folder given with -I is
# searched before the library's.
#
# File systems of Windows and macOS take ``Math.h`` for ``math.h``, so that all names are
# compared without their case.

_C = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbit
stdbool stdckdint stddef stdint stdio stdlib stdmchar stdnoreturn string tgmath threads time uchar wchar wctype
"""

_CPP = """
algorithm any array atomic barrier bit bitset cassert ccomplex cctype cerrno cfenv cfloat charconv chrono cinttypes
ciso646 climits clocale cmath codecvt compare complex concepts condition_variable contracts coroutine csetjmp csignal
cstdalign cstdarg cstdbool cstddef cstdint cstdio cstdlib cstring ctgmath ctime cuchar cwchar cwctype debugging deque
exception execution expected filesystem flat_map flat_set format forward_list fstream functional future generator
hazard_pointer hive initializer_list inplace_vector iomanip ios iosfwd iostream istream iterator latch limits linalg
list locale map mdspan memory memory_resource meta mutex new numbers numeric optional ostream print queue random ranges
ratio rcu regex scoped_allocator semaphore set shared_mutex simd source_location span spanstream sstream stack
stacktrace std stdexcept stdfloat stop_token streambuf string string_view strstream syncstream system_error
text_encoding thread tuple type_traits typeindex typeinfo unordered_map unordered_set utility valarray variant vector
version
"""

_SYSTEM = """
aio alloca aliases argp argz ar bits byteswap conio cpio cxxabi dirent direct dlfcn elf endian err error execinfo
fcntl features fmtmsg
fnmatch ftw getopt glob grp iconv immintrin intrin io langinfo libgen link malloc mem memory monetary mqueue ndbm net
netdb nl_types omp poll process pthread pwd quadmath regex regexp reent resolv sched search semaphore share spawn stab
strings syscall sysexits syslog syslimits tar term termios trace ucontext ulimit unistd unwind utime utmp utmpx values
varargs wait windows winsock2 wordexp newlib picolibc xlocale stdfix float_h yvals yvals_core corecrt vcruntime
crypt envz fstab fts gconv gshadow ifaddrs lastlog mcheck mntent nss obstack paths printf pty re_comp shadow sgtty
stdio_ext termcap termio thread_db ttyent
con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
"""

_VENDOR = """
main arm_math arm_math_types arm_math_memory arm_const_structs arm_common_tables arm_acle arm_cmse arm_fp16 arm_mve
arm_mve_types arm_neon arm_bf16 arm_cde arm_helium_utils arm_vec_math tz_context mpu_armv7 mpu_armv8 pmu_armv8
cachel1_armv7 rte_components rte_device task timers event_groups stream_buffer message_buffer croutine portable
projdefs deprecated_definitions atomic stack_macros mpu_wrappers portmacro portable list queue semphr tx_api tx_port
ux_api fx_api nx_api os_cpu os_cfg ucos_ii rtthread rtconfig rtdef zephyr device devicetree kernel
gpio tim adc dma usart spi i2c can fdcan rcc pwr flash crc rtc iwdg wwdg hrtim cordic fmac opamp comp dac
usb_device usbd_conf usbd_desc usb_host fatfs lwip ethernetif
pwm_curr_fdbk speed_pos_fdbk speed_torq_ctrl pid_regulator ramp_ext_mngr circle_limitation pqd_motorpowermeasurement
bus_voltage_sensor ntc_temperature_sensor open_loop revup_ctrl sto_speed_pos_fdbk virtual_speed_sensor digital_output
parameters_conversion drive_parameters power_stage_parameters pmsm_motor_parameters regular_conversion_manager
flux_weakening_ctrl max_torque_per_ampere feed_forward_ctrl encoder_speed_pos_fdbk hall_speed_pos_fdbk trajectory_ctrl
f2802x f2803x f2806x f28002x f28003x f28004x f2807x f2837xd f2837xs f2838x f28p55x f28p65x device_config driverlib
hw_types hw_memmap iqmathlib math_hal mathlib fpu clarke park ipark svgen ctrl est hal hal_data user types
fsl_common fsl_clock fsl_device_registers board pin_mux clock_config peripherals mlib gflib gmclib gdflib amclib gpclib
mlib_types fsl_adc fsl_pwm hal_gpio hal_entry bsp_api common_data r_ioport r_typedefs iodefine xmc_common xmc_gpio
cy_device cy_pdl cybsp cyhal sam samd21 saml21 same54 atmel_start definitions xc dspic33 p33exxxx avr interrupt
pico pico_stdlib hardware esp_system sdkconfig nrf nrfx nrf_gpio em_device em_chip renesas arduino wiring hardwareserial
wprogram wire simplefoc rtwtypes rt_nonfinite rtw_continuous rtw_solver multiword_types zero_crossing_types
tmwtypes builtin_typeid_types simstruc
"""

_FAMILIES = re.compile(
    r"stm32\w*|stm8\w*|system_\w+|startup_\w+|core_(?:c[amr]\w+|sc\d+|starmc\w*)|cmsis\w*|freertos\w*|arm_math\w*"
    r"|arm_nn\w*|mc_\w+|mcp_\w+|motorcontrol\w*|misra_\w+|fsl_\w+|nrf_\w+|nrfx_\w+|esp_\w+|lpc\d+\w*|mk[elv]\d+\w*"
    r"|mimxrt\w*|gd32\w*|at32\w*|apm32\w*|hc32\w*|hk32\w*|mm32\w*|ch32\w*|xmc[147]\w*|tle98\w*|tms320\w*|msp43\w*"
    r"|hw_\w+|r_cg_\w+|r_bsp\w*"
)

# Names that Windows keeps for devices, whatever their suffix.
_DEVICE = re.compile(r"con|prn|aux|nul|(?:com|lpt)[0-9]")
_STANDARD = frozenset((_C + _CPP).split())
_OTHERS = frozenset((_SYSTEM + _VENDOR).split())

# What follows the prefix in the names of written headers.
SUFFIXES = tuple(
    suffix + kind
    for suffix in (
        "",
        "_control",
        "_control_q15",
        "_control_q31",
        "_reference_q15",
        "_reference_q31",
        "_observer",
        "_observer_q15",
        "_observer_q31",
        "_speed_observer",
        "_speed_measurement",
        "_online_estimation",
        "_commissioning",
        "_start_observer",
        "_startup",
        "_six_step",
        "_current_feedback",
        "_hardware",
        "_application",
        "_waveform",
        "_modulation",
        "_gains",
        "_weakening",
        "_frames",
    )
    for kind in ("", "_vectors")
)


def taken_header(prefix: str) -> str:
    """What a header is whose name one of the files of a prefix would have,
    such as ``the standard header math.h``.

    Empty where all names are free.
    """
    for suffix in SUFFIXES:
        name = (prefix + suffix).casefold()
        if _DEVICE.fullmatch(name):
            return f"{name}.h, which Windows keeps for a device"
        if name in _STANDARD:
            return f"{name}.h, a header of the standard library"
        if name in _OTHERS or _FAMILIES.fullmatch(name):
            return f"{name}.h, a common header of operating systems and vendors"
    # A prefix such as math_h is what remains of "math.h", and means the same.
    stem = re.sub(r"_(?:h|hpp|hxx)$", "", prefix.casefold())
    return taken_header(stem) if stem != prefix.casefold() else ""


# Which kind of value an entry has: by the words of its text, or by its key ``kind``.

# Words that suggestions know besides the names of the kinds.
SPELLINGS = (
    "phase-to-phase",
    "terminal",
    "terminal-to-terminal",
    "l-l",
    "per phase",
    "phase-to-neutral",
    "winding",
    "pk",
    "amplitude",
    "effective",
)


@dataclass(frozen=True, slots=True)
class KindChoice:
    """Kinds of which an entry has one.

    Args:
        kinds: Their names, such as ``phase`` and ``line-to-line``.
        places: What other places are called here (`Dimension.places`).
    """

    kinds: tuple[str, ...]
    places: Mapping[str, str]

    def named(self, text: str) -> KindWords:
        """Marks of the key ``kind``.

        Raises:
            InputError: The text is no kind, or leaves it open.
        """
        words = kind_words(text)
        if words is None:
            raise InputError(self._none_of(text))
        return words

    def meant(self, said: Sequence[KindWords], value: str = "") -> str | None:
        """The kind that is meant by what the text and the key say, None where they say nothing;
        ``value`` is the text of the value, for what is proposed.

        Raises:
            InputError: They contradict each other, name none of the kinds, or leave open which.
        """
        marks = [(words, (self._place(words), words.measure)) for words in said]
        place, measure = (
            next((mark[slot] for _, mark in marks if mark[slot]), "") for slot in (0, 1)
        )
        for words, mark in marks:
            if mark[0] not in ("", place) or mark[1] not in ("", measure):
                raise InputError(
                    f"the text states {shown(said[0].text)}, its kind is {shown(words.text)}; "
                    "remove the wrong one"
                )
        if not place and not measure:
            return None
        texts = ", ".join(words.text for words in said)
        slots = {kind: _slots(kind) for kind in self.kinds}
        exact = [kind for kind, own in slots.items() if own == (place, measure)]
        fitting = exact or [
            kind
            for kind, (own_place, own_measure) in slots.items()
            if place in ("", own_place) and measure in ("", own_measure)
        ]
        if not fitting:
            raise InputError(self._none_of(texts))
        if len(fitting) > 1:
            raise InputError(
                f"{shown(texts)} leaves open {' or '.join(fitting)}; {_rms_or_peak(fitting, value)}"
            )
        return fitting[0]

    def _place(self, words: KindWords) -> str:
        """The place that words name, as the kinds call it; empty where it says nothing here."""
        known = {_slots(kind)[0] for kind in self.kinds}
        place: str | None = words.place
        while place and place not in known:
            place = self.places.get(place)
        if place is None:
            raise InputError(self._none_of(words.text))
        return place

    def _none_of(self, text: str) -> str:
        near = close_matches(text, [*self.kinds, *SPELLINGS], limit=1)
        hint = f"; did you mean '{near[0]}'?" if near and near[0] != text else ""
        return f"expected one of {', '.join(self.kinds)}, got the text {shown(text)}{hint}"


_TWO_WIRES = ["line-to-line peak", "line-to-line rms"]


def _rms_or_peak(kinds: list[str], value: str) -> str:
    """What to write where kinds are left open: of two wires the instruments tell."""
    if kinds != _TWO_WIRES:
        return "write one"
    peak, rms = kinds
    return (
        f"a multimeter on AC shows rms: '{value} {rms}'; peak of a scope: '{value} {peak}'".replace(
            "' ", "'"
        )
    )


@cache
def _slots(kind: str) -> tuple[str, str]:
    """Place and measure of the name of a kind."""
    words = kind_words(kind)
    return ("", "") if words is None else (words.place, words.measure)


# Names that may stand in generated code.

MAX_PREFIX = 31  # C99 guarantees no more significant characters of an external name


_C_KEYWORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main
alignas alignof bool constexpr false nullptr static_assert thread_local true typeof typeof_unqual
"""


_CPP_KEYWORDS = """
and and_eq asm atomic_cancel atomic_commit atomic_noexcept bitand bitor catch char8_t char16_t char32_t class compl
concept consteval constinit const_cast co_await co_return co_yield decltype delete dynamic_cast explicit export friend
mutable namespace new noexcept not not_eq operator or or_eq private protected public reflexpr reinterpret_cast requires
static_cast synchronized template this throw try typeid typename using virtual wchar_t xor xor_eq std
"""


KEYWORDS = frozenset(_C_KEYWORDS.split()) | frozenset(_CPP_KEYWORDS.split())


def _free(prefix: str) -> str:
    """Prefix like the one that is taken, whose files shadow nothing."""
    for candidate in (f"{prefix[: MAX_PREFIX - 1]}1", f"my_{prefix}"[:MAX_PREFIX].rstrip("_")):
        if not taken_header(candidate):
            return candidate
    return "motor1"


def check_prefix(prefix: str) -> str:
    """Prefix of all names in the generated code, unchanged.

    Raises:
        EntryError: The prefix is no identifier in C and C++, or reserved there, or a header of its
            name would shadow one of the standard library or of a vendor.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", prefix, re.ASCII):
        # Letters with accents keep their base letter: Motör becomes Motor.
        plain = unicodedata.normalize("NFKD", prefix).encode("ascii", "ignore").decode()
        hint = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_0123456789")[:MAX_PREFIX].strip("_")
        write = f"; write e.g. {hint}" if hint and hint not in KEYWORDS else "; write e.g. motor1"
        raise EntryError(
            f"{shown(prefix)} is not an identifier in C: letters, digits and '_', a letter "
            f"first{write}"
        )
    if prefix.startswith("_") or prefix.endswith("_") or "__" in prefix:
        hint = re.sub(r"_+", "_", prefix).strip("_") or "motor1"
        raise EntryError(
            f"{shown(prefix)} leads to names that C and C++ reserve ('_' outside, '__'); write "
            f"e.g. {hint}"
        )
    if len(prefix) > MAX_PREFIX:
        raise EntryError(f"the prefix has {len(prefix)} characters; write at most {MAX_PREFIX}")
    if prefix in KEYWORDS:
        raise EntryError(f"{shown(prefix)} is a word of C or C++; write e.g. {prefix}1")
    if taken := taken_header(prefix):
        raise EntryError(
            f"{shown(prefix)} would write a file that shadows {taken}; write e.g. {_free(prefix)}"
        )
    return prefix
