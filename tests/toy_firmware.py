"""A firmware of no one, for tests of what chooses and judges gains within a structure."""

from __future__ import annotations

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    LoopProfile,
    PiController,
    PiGains,
    PiRule,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    Asked,
    FirmwareMethod,
    FreeGains,
    Price,
    Shortfall,
)

MOST_PLL_KI = 4e6


def rounded(value: float) -> float:
    """As six digits print it."""
    return float(f"{value:.6g}")


def toy_method(
    free: FreeGains = "axes",
    *,
    delay: float = 1.0,
    rule: PiRule = "integral-first",
    filter_time: float = 0.0,
    pll: tuple[float, float] | None = (2000.0, 30000.0),
) -> FirmwareMethod:
    """A firmware with the gains and the structure that are named; ``pll`` None: speed as it is."""

    def configure(asked: Asked) -> Configuration:
        d, q = asked.current_d, asked.current_q
        if free == "one-pair":
            d = q = PiGains(0.5 * (d.kp + q.kp), 0.5 * (d.ki + q.ki))
        if free == "bandwidth":
            assert asked.drive.l_d is not None
            assert asked.drive.l_q is not None
            assert asked.drive.r_s is not None
            omega = rounded(q.kp / asked.drive.l_q)
            d = PiGains(omega * asked.drive.l_d, omega * asked.drive.r_s)
            q = PiGains(omega * asked.drive.l_q, omega * asked.drive.r_s)
        own_pll = asked.pll or (None if pll is None else PiGains(*pll))
        own = {} if own_pll is None else {"pll_kp": own_pll.kp, "pll_ki": own_pll.ki}
        if own_pll is not None and own_pll.ki > MOST_PLL_KI:
            raise InputError("control.firmware.pll_ki: too large for this toy")
        return Configuration(
            "vesc",
            "toy",
            asked.design.name,
            asked.drive,
            PiGains(rounded(d.kp), rounded(d.ki)),
            PiGains(rounded(q.kp), rounded(q.ki)),
            None if asked.speed is None else PiGains(*map(rounded, _pair(asked.speed))),
            own,
        )

    def profile(found: Configuration) -> LoopProfile:
        t_s, t_speed = found.drive.t_s, found.drive.t_speed
        assert t_s is not None
        assert found.current_d is not None
        assert found.current_q is not None
        d, q = (
            PiController(gains.kp, gains.ki, t_s, rule, filter_time=filter_time)
            for gains in (found.current_d, found.current_q)
        )
        speed = None
        if found.speed is not None and t_speed is not None:
            kp, ki = found.own.get("pll_kp", 0.0), found.own.get("pll_ki", 0.0)
            estimate = SpeedEstimate("ideal" if pll is None else "pll", t_s, float(kp), float(ki))
            pi = PiController(found.speed.kp, found.speed.ki, t_speed, "integral-last")
            speed = SpeedController(pi, estimate)
        return LoopProfile("vesc", "toy", CurrentLoops(d, q, delay, back_emf=True), speed)

    def shortfalls(asked: Asked, found: Configuration) -> tuple[Shortfall, ...]:
        if free == "axes" or asked.current_d == asked.current_q:
            return ()
        return (Shortfall("one pair of gains for both axes", (Price("gain", 0.1, ""),)),)

    return FirmwareMethod("vesc", "toy", free, configure, profile, shortfalls)


def _pair(gains: PiGains) -> tuple[float, float]:
    return gains.kp, gains.ki
