"""What a current reference owes to the ends of a flux map, in sentences."""

from __future__ import annotations

from dqforge.optimizer.current_reference.data_use import DataUse
from dqforge.reports.plain_data import PlainData


def data_lines(data: DataUse, end: float) -> list[str]:
    """Sentences of at most 110 characters, none where the data cover a reference up to ``end`` N
    m.
    """
    lines = []
    if data.held is not None:
        lines.append(
            f"{_where(data.held, end)} the currents are held by the data: the flux map ends there,"
        )
        lines.append("currents of less loss may lie beyond it.")
    if data.extrapolated is not None:
        lines.append(
            f"{_where(data.extrapolated, end)} the currents lie beyond the flux map, which is "
            "extrapolated"
        )
        lines.append("along its tangents (flux_map.extrapolate: true): no data support them.")
    return lines


def _where(torques: tuple[float, float], end: float) -> str:
    low, high = torques
    start = "From zero torque" if low == 0.0 else f"From {low:.4g} N m"
    return f"{start} on" if high >= end * (1.0 - 1e-9) else f"{start} to {high:.4g} N m"


def plain_data_use(data: DataUse) -> PlainData:
    """Ranges of the torque as plain data."""
    return {"held_by_data_Nm": data.held, "extrapolated_Nm": data.extrapolated}
