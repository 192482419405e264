"""Currents beyond those in proportion to the torque on numpy arrays of float32: as ``limited.j2``,
same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Triple, clarke
from dqforge.reports.c_code.float32_functions import SINGLE
from dqforge.reports.c_code.read_back import single_from
from dqforge.reports.phase_control.float32_duties import Stationary
from dqforge.reports.phase_control.float32_parts import equal_load, mean_of_phases, node_of, rows_of
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.phase_control.phase_controller import LimitedShapes

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@dataclass(frozen=True, slots=True)
class _Load:
    """Where a speed lies among the nodes: interval, share of it, and both torques there."""

    inside: NDArray[np.bool_]
    row: NDArray[np.int64]
    above: SingleArray
    plain: SingleArray
    most: SingleArray


@dataclass(frozen=True, slots=True)
class LimitedPlace:
    """Where an operating point lies in the table: intervals and shares of speed and torque.

    ``sign`` is 1 for motoring forwards, -1 for its mirror, 0 where the table adds nothing.
    """

    row: NDArray[np.int64]
    above: SingleArray
    column: NDArray[np.int64]
    beside: SingleArray
    sign: SingleArray


@dataclass(frozen=True, slots=True, eq=False)
class LimitedTable:
    """The table in float32.

    ``omega_e`` in rad/s, ``plain`` and ``most`` in N m, shape (W,); ``current`` in A, shape (1 or
    3, W, S, nodes + 1), the last node as the first; ``v_nominal`` in V.
    """

    omega_e: SingleArray
    plain: SingleArray
    most: SingleArray
    current: SingleArray
    v_nominal: np.float32
    mirrored: bool

    def _load(self, omega_e: SingleArray, v_dc: SingleArray) -> _Load:
        nodes = self.omega_e
        load = equal_load(np.abs(omega_e), v_dc, self.v_nominal, nodes[-1])
        row = np.zeros(load.shape, dtype=np.int64)
        for inner in nodes[1:-1]:
            row = row + (load > inner)
        above = (load - nodes[row]) / (nodes[row + 1] - nodes[row])
        above = np.where(above > _ONE, _ONE, np.where(above > _ZERO, above, _ZERO))
        plain, most = (
            table[row] + (above * (table[row + 1] - table[row]))
            for table in (self.plain, self.most)
        )
        forward = omega_e >= _ZERO
        inside = (load >= nodes[0]) & (forward | np.bool_(self.mirrored))
        return _Load(inside, row, above, plain, most)

    def largest_torque(
        self, torque: SingleArray, omega_e: SingleArray, v_dc: SingleArray, most: SingleArray
    ) -> SingleArray:
        """The larger of a limit and that of the table, in N m, for motoring torques; shape (N,)."""
        found = self._load(omega_e, v_dc)
        motors = found.inside & ((torque * omega_e) > _ZERO) & (found.most > most)
        return np.where(motors, found.most, most)

    def place(
        self,
        torque: SingleArray,
        omega_e: SingleArray,
        v_dc: SingleArray,
        opened: NDArray[np.uint32],
    ) -> LimitedPlace:
        """Where torques in N m, speeds in rad/s and links in V lie, shape (N,)."""
        found = self._load(omega_e, v_dc)
        motors = found.inside & ((torque * omega_e) > _ZERO) & (opened == 0)
        span = found.most - found.plain
        there = span > _ZERO
        share = np.where(there, (np.abs(torque) - found.plain) / np.where(there, span, _ONE), _ZERO)
        share = np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))
        steps = self.current.shape[2] - 1
        share = share * np.float32(steps)
        column = np.minimum(share.astype(np.int64), steps - 1)
        sign = np.where(omega_e < _ZERO, -_ONE, _ONE)
        return LimitedPlace(
            found.row, found.above, column, share - column.astype(np.float32),
            np.where(motors, sign, _ZERO),
        )  # fmt: skip

    def deviation(self, at: LimitedPlace, place: SingleArray) -> Stationary:
        """Currents in A to add, at a place in lengths of the table, shape (N,)."""
        k, share = node_of(self.current.shape[-1] - 1, at.sign * place)
        corners = []
        for i, weight_i in ((0, _ONE - at.above), (1, at.above)):
            for j, weight_j in ((0, _ONE - at.beside), (1, at.beside)):
                table = self.current[:, at.row + i, at.column + j]
                rows = rows_of(table, k)
                corners.append((weight_i * weight_j, rows))
        phases = []
        for phase in range(3):
            total = np.zeros_like(place)
            for weight, rows in corners:
                here, there = rows[phase]
                total = total + (weight * (here + (share * (there - here))))
            phases.append(total)
        values = Triple(*phases)
        plane, size = clarke(SINGLE, values), np.abs(at.sign)
        return Stationary(size * plane.x, at.sign * plane.y, size * mean_of_phases(values))


def plain_limited(limited: LimitedShapes | None) -> PlainData | None:
    """The table as plain data, every number a float32 value."""
    if limited is None:
        return None

    def singles(values: Any) -> Any:
        if np.ndim(values) == 0:
            return shortest(np.float32(values))
        return [singles(part) for part in values]

    closed = np.concatenate([limited.deviation, limited.deviation[..., :1]], axis=-1)
    return {
        "omega_e": singles(limited.omega_e),
        "plain": singles(limited.plain),
        "most": singles(limited.most),
        "current": singles(closed),
        "v_nominal": singles(limited.v_nominal),
        "mirrored": limited.mirrored,
    }


def limited_from(plain: Mapping[str, Any], shape: tuple[int, ...]) -> LimitedTable:
    """The table from data as `plain_limited` makes them.

    ``shape`` is that of the table of the back-EMF. Raises KeyError, TypeError or ValueError where
    they are not.
    """

    def singles(values: Any) -> Any:
        return (
            [singles(part) for part in values] if isinstance(values, list) else single_from(values)
        )

    axes = {
        name: np.array(singles(plain[name]), dtype=np.float32)
        for name in ("omega_e", "plain", "most")
    }
    current = np.array(singles(plain["current"]), dtype=np.float32)
    count, nominal = axes["omega_e"].size, single_from(plain["v_nominal"])
    fits = current.ndim == 4 and current.shape[1] == count and current.shape[2] >= 2
    if not fits or (current.shape[0], current.shape[3]) != shape or count < 2:
        raise ValueError(current.shape)
    if any(axis.shape != (count,) for axis in axes.values()) or not nominal > 0.0:
        raise ValueError(count)
    if not np.all(np.diff(axes["omega_e"]) > 0.0) or not isinstance(plain["mirrored"], bool):
        raise ValueError(plain["mirrored"])
    return LimitedTable(
        axes["omega_e"], axes["plain"], axes["most"], current, np.float32(nominal),
        plain["mirrored"],
    )  # fmt: skip
