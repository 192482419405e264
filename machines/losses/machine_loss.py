"""Losses of a machine beyond the dc copper loss: alternating-current copper loss,
iron loss and magnet loss.

Source of the iron loss: G. Bertotti, "General properties of power losses in soft ferromagnetic
materials", IEEE Transactions on Magnetics 24(1), 1988, doi:10.1109/20.43994 (hysteresis and
eddy-current terms).
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class MachineLoss:
    """Losses of the machine beyond the dc copper loss; all zero by default.

    Args:
        ac_copper: k_ac in s^2/rad^2: the resistance that makes heat is R (1 + k_ac omega_e^2).
        hysteresis, eddy: k_h in W s/(rad Wb^2) and k_c in W s^2/(rad^2 Wb^2): iron loss (k_h
            |omega_e| + k_c omega_e^2) |psi|^2 with the peak dq flux linkage.
        magnet: k_m in W s^2/(rad^2 A^2): eddy-current loss k_m omega_e^2 |i|^2 of the magnets under
            the field of the winding, with the peak dq current.
    """

    ac_copper: float = 0.0
    hysteresis: float = 0.0
    eddy: float = 0.0
    magnet: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no loss."""
        for name in ("ac_copper", "hysteresis", "eddy", "magnet"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"machine loss: {name} must be zero or positive, got {value:g}")

    def copper_factor(self, omega_e: FloatArray) -> FloatArray:
        """AC over dc copper loss at electrical speeds in rad/s, any shape."""
        return 1.0 + self.ac_copper * omega_e * omega_e

    def iron_factor(self, omega_e: FloatArray) -> FloatArray:
        """Iron loss over |psi|^2 in W/Wb^2 at electrical speeds in rad/s, any shape."""
        return self.hysteresis * np.abs(omega_e) + self.eddy * omega_e * omega_e

    @classmethod
    def measured(
        cls,
        *,
        frequency: float = 0.0,
        flux: float = 0.0,
        hysteresis: float = 0.0,
        eddy: float = 0.0,
        resistance_ratio: float = 1.0,
        resistance_frequency: float = 1.0,
        magnet: float = 0.0,
        magnet_frequency: float = 1.0,
        magnet_current: float = 1.0,
    ) -> MachineLoss:
        """Coefficients from a measurement or a computation.

        Args:
            frequency, flux: Electrical frequency in Hz and flux linkage in Wb (peak) of the two
                iron losses.
            hysteresis, eddy: The two parts of the iron loss there, in W.
            resistance_ratio, resistance_frequency: AC over dc resistance at an electrical frequency
                in Hz.
            magnet, magnet_frequency, magnet_current: Magnet loss in W at an electrical frequency in
                Hz and a current in A (peak).
        """
        omega, square = 2.0 * math.pi * frequency, flux * flux
        return cls(
            ac_copper=(resistance_ratio - 1.0) / (2.0 * math.pi * resistance_frequency) ** 2,
            hysteresis=hysteresis / (omega * square) if hysteresis else 0.0,
            eddy=eddy / (omega * omega * square) if eddy else 0.0,
            magnet=magnet / (2.0 * math.pi * magnet_frequency * magnet_current) ** 2,
        )


NO_EXTRA_LOSS = MachineLoss()
