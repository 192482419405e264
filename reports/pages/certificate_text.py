"""Words for what is proven of a current reference, alike in header, terminal and report."""

from __future__ import annotations

import math
from dataclasses import asdict

from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.field_weakening.certificate import SurfaceCertificate
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.plain_data import PlainData

# What the ``model`` of a certificate is called.
AGAINST = {
    "equations": "the equations of the machine",
    "splines": "the splines through its flux map",
}

JSON_DIGITS = 9  # Significant digits of numbers in JSON documents.
_CURRENTS_AND_TORQUE = (("i_d", "A"), ("i_q", "A"), ("torque", "N m"))


def proof_title(certificate: Certificate) -> str:
    """Against what the bounds hold, and for what."""
    return f"proven for every torque, rounding included, against {AGAINST[certificate.model]}"


def _bound(value: float | None, unit: str, digits: int) -> str:
    return "not bounded" if value is None else f"{rounded_up(value, digits)} {unit}"


def _share(value: float | None, digits: int) -> str:
    return _bound(
        None if value is None else math.nextafter(100.0 * value, math.inf) if value else 0.0,
        "%",
        digits,
    )


def proven_text(certificate: Certificate, digits: int = 2) -> str:
    """All bounds in one line."""
    parts = [
        f"i_d {_bound(certificate.i_d, 'A', digits)}",
        f"i_q {_bound(certificate.i_q, 'A', digits)}",
        f"torque {_share(certificate.torque_relative, digits)}",
        f"copper loss +{_share(certificate.loss_relative, digits)}",
    ]
    if certificate.voltage_excess is not None:
        parts.append(f"voltage +{_share(certificate.voltage_excess, digits)}")
    return ", ".join(parts)


def header_lines(certificate: Certificate, strategy: str) -> list[str]:
    """Bounds as lines of at most 110 characters for the comment of the evaluator."""
    voltage = certificate.voltage_excess
    i_d, i_q, torque = (
        _bound(getattr(certificate, name), unit, 3) for name, unit in _CURRENTS_AND_TORQUE
    )
    torque_share, loss_share = (
        _share(value, 3) for value in (certificate.torque_relative, certificate.loss_relative)
    )
    return [
        f"Bounds of the errors, {proof_title(certificate)}:",
        f"i_d {i_d}, i_q {i_q} against the exact {strategy} currents;",
        f"torque {torque} ({torque_share} of the largest torque);",
        (
            f"copper loss {_bound(certificate.loss, 'W', 3)} above the least ({loss_share} from 5 "
            "% torque up)."
        ),
        *(
            []
            if voltage is None
            else [f"phase voltage at most {_share(voltage, 3)} above its limit."]
        ),
    ]


def plain_certificate(certificate: Certificate | SurfaceCertificate | None) -> PlainData | None:
    """Bounds as plain data, rounded up to the digits that the document keeps.

    None where nothing is proven.
    """
    if certificate is None:
        return None
    plain = asdict(certificate).items()
    return {
        name: float(rounded_up(value, JSON_DIGITS)) if isinstance(value, float) else value
        for name, value in plain
    }
