"""Stand-ins for SimpleFOC that are ours: the members of its motor in C++, and its Commander."""

from __future__ import annotations

import re

from dqforge.reports.firmware.simplefoc import ENUMERATORS

STUB = """// Only what a configuration touches.
#include <stdint.h>
enum TorqueControlType : uint8_t { voltage = 0, dc_current = 1, foc_current = 2 };
enum MotionControlType : uint8_t { torque = 0, velocity = 1, angle = 2 };
enum FOCModulationType : uint8_t { SinePWM = 0, SpaceVectorPWM = 1 };
struct PIDController { float P = 3.0f, I = 300.0f, D = 1.0f, output_ramp = 1e3f, limit = 12.0f; };
struct LowPassFilter { float Tf = 0.005f; };
struct DQ_s { float d = -12345.0f, q = -12345.0f; };
class BLDCMotor {
public:
    BLDCMotor(int pp, float R = -1.0f, float KV = -1.0f, float Lq = -1.0f, float Ld = -1.0f)
        : pole_pairs(pp), phase_resistance(R), KV_rating(KV)
    {
        axis_inductance.d = Ld;
        axis_inductance.q = Lq;
    }
    int pole_pairs;
    float phase_resistance, KV_rating, phase_inductance = -1.0f;
    DQ_s axis_inductance;
    float voltage_limit = 12.0f, current_limit = 2.0f, velocity_limit = 20.0f;
    unsigned int motion_downsample = 0;
    TorqueControlType torque_controller = TorqueControlType::voltage;
    MotionControlType controller = MotionControlType::torque;
    FOCModulationType foc_modulation = FOCModulationType::SinePWM;
    PIDController PID_current_q, PID_current_d, PID_velocity;
    LowPassFilter LPF_current_q, LPF_current_d, LPF_velocity;
};
"""


PID = {"P": "P", "I": "I", "D": "D", "R": "output_ramp", "L": "limit"}


CONTROLLERS = {"Q": "current_q", "D": "current_d", "V": "velocity"}


class Commander:
    """Commander::run and Commander::motor as far as a configuration goes, from their description.

    Characters fill a buffer of 20; a line end runs it, a full buffer is thrown away. The first
    character picks the motor, the next one or two the member, the rest is read by atof.
    """

    def __init__(self, letter: str = "M") -> None:
        self.letter, self.buffer = letter, ""
        self.members: dict[str, float] = {}

    def feed(self, text: str) -> dict[str, float]:
        """Run a text, and give what the motor then holds."""
        for character in text:
            self.buffer += character
            if character == "\n":
                self.run(self.buffer[:-1])
                self.buffer = ""
            assert len(self.buffer) < 20, f"the buffer overruns at {self.buffer!r}"
        return self.members

    def run(self, line: str) -> None:
        """One line: lines of other letters run nothing."""
        if line[:1] != self.letter:
            assert line[:1] not in "?@#", "would run a command of the Commander itself"
            return
        command = line[1:]
        sub = command[1:2] if command[1:2].isupper() else ""
        value = self.atof(command[1 + len(sub) :])
        kind = command[0]
        if kind in CONTROLLERS:
            controller = CONTROLLERS[kind]
            if sub == "F":
                self.members[f"LPF_{controller}.Tf"] = value
            else:
                self.members[f"PID_{controller}.{PID[sub]}"] = value
        elif kind == "L":
            self.limit({"U": "voltage", "C": "current", "V": "velocity"}[sub], value)
        elif kind == "I":
            self.members[f"axis_inductance.{sub.lower()}"] = value
        else:
            name = {
                "R": "phase_resistance",
                "K": "KV_rating",
                "T": "torque_controller",
                "C": "motion_downsample" if sub == "D" else "controller",
                "W": "foc_modulation",
            }[kind]
            assert kind != "W" or sub == "T"
            assert name not in ENUMERATORS or 0 <= value < len(ENUMERATORS[name])
            self.members[name] = value

    def limit(self, name: str, value: float) -> None:
        """A limit, with the limits of controllers that it sets (updateVoltageLimit and others)."""
        self.members[f"{name}_limit"] = value
        if name == "voltage":
            self.members["PID_current_q.limit"] = self.members["PID_current_d.limit"] = value
        elif name == "current" and self.members.get("torque_controller", 0) != 0:
            self.members["PID_velocity.limit"] = value

    @staticmethod
    def atof(text: str) -> float:
        """The longest number at the beginning of a text, 0 without one."""
        found = re.match(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
        assert found is not None
        assert found[0] == text, f"atof would leave out a part of {text!r}"
        return float(found[0])
