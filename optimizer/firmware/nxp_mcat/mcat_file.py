"""A file of MCAT with all that it amounts to, whichever way it came about."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, Origin, OwnValue
from dqforge.optimizer.firmware.nxp_mcat.mcat_constants import SPEED_I, constants
from dqforge.optimizer.firmware.nxp_mcat.mcat_edition import (
    EDITIONS,
    FIXED_2019,
    FIXED_2022,
    FLOAT_2019,
    FLOAT_2022,
    FLOAT_2025,
    Edition,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_findings import contradictions, conventions
from dqforge.optimizer.firmware.nxp_mcat.mcat_names import PROJECT_INPUTS, PROJECT_MACROS
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import printed
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import McatSheet, kind_of

_INTEGRALS = ("M1_D_KI_GAIN", "M1_Q_KI_GAIN")


@dataclass(frozen=True, slots=True)
class McatFile:
    """One file.

    Args:
        name: Of the motor.
        edition: The age of the format, and its arithmetic.
        own: Inputs by MCAT's keys and constants by their macros.
        origins: Where they stand in a file that was read.
    """

    name: str
    edition: Edition
    own: Mapping[str, OwnValue]
    origins: Mapping[str, Origin] = field(default_factory=dict)

    @classmethod
    def read(
        cls,
        name: str,
        own: Mapping[str, OwnValue],
        origins: Mapping[str, Origin],
        *,
        fixed: bool,
        commented: bool,
    ) -> McatFile:
        """A file whose age is to be found from what stands in it.

        Args:
            name: Of the motor.
            own, origins: Inputs and constants, and where they stand.
            fixed: Whether constants stand in fractions.
            commented: Whether inputs stand in line comments, or numbers have more than six digits.
        """
        if fixed:
            edition = FIXED_2019 if commented else FIXED_2022
        elif commented:
            edition = FLOAT_2019
        else:
            edition = _float_edition(own)
        return cls(name, edition, own, origins)

    @classmethod
    def of(cls, found: Configuration) -> McatFile:
        """That of a configuration."""
        return cls(found.name, EDITIONS[found.version], found.own, found.origins)

    def configuration(self) -> Configuration:
        """What it amounts to."""
        sheet = self.sheet
        return sheet.configuration(
            self.name, self.origins, conventions(sheet), contradictions(sheet)
        )

    @property
    def sheet(self) -> McatSheet:
        """Its numbers."""
        return McatSheet(self.edition, self.own)

    def kind(self, macro: str) -> str:
        """How a constant is written: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``."""
        return kind_of(macro, self.edition)

    def in_edition(self, version: str) -> McatFile:
        """The same loops in the format of another age of the same arithmetic.

        The speed filter keeps its cut-off as the firmware runs it: with the period of the speed
        loop, whatever MCAT of that age makes of it.

        Args:
            version: Name of the edition.
        """
        edition = EDITIONS[version]
        if edition == self.edition:
            return self
        inputs = {key: value for key, value in self.own.items() if not key.startswith("M1_")}
        inputs |= self._converted(edition)
        own: dict[str, OwnValue] = {**inputs, **constants(edition, inputs)}
        ratios = dict.fromkeys(_INTEGRALS, edition.current_share / self.edition.current_share)
        ratios[SPEED_I] = edition.speed_share / self.edition.speed_share
        for name in ("M1_D_KP_GAIN", "M1_Q_KP_GAIN", "M1_SPEED_PI_PROP_GAIN", *ratios):
            value = self.sheet.number(name)
            if value is not None:
                scaled = value * ratios.get(name, 1.0)
                own[name] = scaled if edition.commented else printed(scaled)
        return McatFile(self.name, edition, own, self.origins)

    def in_project(self, theirs: McatFile) -> McatFile:
        """The same loops on the board of another file: with its scales, thresholds and ramps.

        A float build alone: in fixed point the gains count in these scales.

        Args:
            theirs: The file of the project, of the same age.
        """
        if self.edition.fixed:
            return self
        own = dict(self.own)
        one, other = self.sheet, theirs.sheet
        outgrown = _outgrown(one, other)
        own |= {
            key: theirs.own[key]
            for key in PROJECT_INPUTS
            if key in theirs.own and not key.startswith(outgrown)
        }
        made: dict[str, OwnValue] = {**constants(self.edition, own)}
        if (one.t_s, one.t_speed, one.pole_pairs) == (other.t_s, other.t_speed, other.pole_pairs):
            made |= theirs.own
        own |= {
            macro: made[macro]
            for macro in PROJECT_MACROS
            if macro in made and not macro.startswith(outgrown)
        }
        return McatFile(self.name, self.edition, own, self.origins)

    def _converted(self, edition: Edition) -> dict[str, OwnValue]:
        """Inputs that mean something else in the other age."""
        sheet, changed = self.sheet, dict[str, OwnValue]()
        torque = sheet.torque()
        if torque is not None and not edition.fixed:
            before = edition.current_share == 1.0
            changed["parametersKe"] = torque / math.sqrt(3.0) if before else torque
        k_p, k_i = sheet.number("M1_SPEED_PI_PROP_GAIN"), sheet.number(SPEED_I)
        if not edition.fixed and k_p is not None and k_i is not None:
            ratio = edition.speed_share / self.edition.speed_share
            changed |= {
                "speedLoopManualConstantTunning": True,
                "speedLoopSLKp": k_p,
                "speedLoopSLKi": k_i * ratio,
            }
        cutoff, t_s, slow = sheet.number("speedLoopCutOffFreq"), sheet.t_s, sheet.t_speed
        if cutoff is not None and t_s and slow and not edition.fixed:
            fast = edition.current_share == 1.0
            was_fast = self.edition.current_share == 1.0
            changed["speedLoopCutOffFreq"] = (
                cutoff * (slow / t_s if fast else 1.0) / (slow / t_s if was_fast else 1.0)
            )
        return changed


def _outgrown(ours: McatSheet, theirs: McatSheet) -> tuple[str, ...]:
    """Starts of the names of thresholds at which the design's link voltage or its largest speed
    would be a fault.
    """
    names: tuple[str, ...] = ()
    voltage, speed = ours.link_voltage(), ours.largest_speed()
    lowest = theirs.number("parametersUdcbUnder") or theirs.number("M1_U_DCB_UNDERVOLTAGE")
    largest = theirs.number("parametersUdcbOver") or theirs.number("M1_U_DCB_OVERVOLTAGE")
    if voltage is not None and not (lowest or 0.0) <= voltage <= (largest or math.inf):
        names += ("parametersUdcbTrip", "parametersUdcbUnder", "parametersUdcbOver")
        names += ("M1_U_DCB_TRIP", "M1_U_DCB_UNDER", "M1_U_DCB_OVER")
    fastest = theirs.constant("M1_N_OVERSPEED")
    pairs = ours.pole_pairs or 1
    if speed is not None and fastest is not None and pairs * speed > fastest:
        names += ("parametersN", "M1_N_", "M1_FREQ_MAX")
    return names


def _float_edition(own: Mapping[str, OwnValue]) -> Edition:
    """By the integral gains where their inputs stand there, else by what only newer files have."""
    errors = {
        edition.version: _misfit(edition, own)
        for edition in (FLOAT_2025, FLOAT_2022)
        if _misfit(edition, own) is not None
    }
    if len(errors) > 1 and errors[FLOAT_2025.version] != errors[FLOAT_2022.version]:
        return EDITIONS[min(errors, key=lambda version: errors[version] or 0.0)]
    newer = "M1_Q_IIR_ZC_B0" in own or ("parametersKt" in own and "parametersKe" not in own)
    return FLOAT_2025 if newer else FLOAT_2022


def _misfit(edition: Edition, own: Mapping[str, OwnValue]) -> float | None:
    made = constants(edition, own)
    found = [
        abs(math.log(float(value) / made[name]))
        for name in _INTEGRALS
        if (value := own.get(name)) and not isinstance(value, str) and made.get(name, 0.0) > 0.0
        if float(value) > 0.0
    ]
    return min(found) if found else None
