"""Headers in the layouts of MCAT, made of inputs and constants, for tests of reader and writer."""

from __future__ import annotations

import json

from nxp_published import Published

PLAIN = ("MOTOR_PP", "E_BLOCK_PER")

ACC32 = ("_KP_GAIN", "_KI_GAIN", "PROP_GAIN", "INTEG_GAIN", "I_SCALE", "U_SCALE", "E_SCALE")

SECTIONS = ("parameters", "currentLoop", "speedLoop", "sensorless")

COMMENTS = {
    "parametersPP": "Pole-pair number                      = {} [-]",
    "parametersRs": "Stator resistance                     = {} [Ohms]",
    "parametersLd": "Direct axis inductance                = {} [H]",
    "parametersLq": "Quadrature axis inductance            = {} [H]",
    "parametersKe": "Back-EMF constant                     = {} [V.sec/rad]",
    "parametersJ": "Drive inertia                         = {} [kg.m2]",
    "parametersIphNom": "Nominal current                       = {} [A]",
}

LOOPS = {
    "Current Loop Control": ("currentLoopF0", "currentLoopKsi", "currentLoopSampleTime"),
    "Speed Loop Control": ("speedLoopF0", "speedLoopKsi", "speedLoopSampleTime"),
    "Sensorless BEMF DQ and Tracking Observer": (
        "sensorlessBemfObsrvF0",
        "sensorlessBemfObsrvKsi",
        "",
    ),
}


def define(name: str, text: str, *, fixed: bool, motor: int = 1) -> str:
    """One macro as MCAT writes it."""
    start = f"#define M{motor}_{name}"
    if name in PLAIN or name.endswith(("_DURATION", "_SHIFT")):
        return f"{start} ({text})"
    if name == "SCALAR_INTEG_GAIN":
        return f"{start} ACC32({text})"
    if name == "MERG_COEFF":
        return f"{start} FRAC16({text})"
    if not fixed or name in ("N_MAX", "FREQ_MAX", "I_MAX", "U_MAX", "E_MAX", "U_DCB_MAX"):
        return f"{start} ({text}F)"
    if "_IIR_" in name or "_RAMP_" in name:
        return f"{start} FRAC32({text})"
    wide = name.endswith(ACC32) and not name.startswith("TO_")
    return f"{start} {'ACC32' if wide else 'FRAC16'}({text})"


def header(data: Published, *, motor: int = 1, inputs: bool = True) -> str:
    """A header of either age with its inputs, or without."""
    fixed, commented = "fixed" in data.version, data.version.startswith("2019")
    lines = ["/*", "    * Any words on Copyright and License", "*/", ""]
    if inputs and not commented:
        held = {
            section: {key: value for key, value in data.inputs.items() if key.startswith(section)}
            for section in SECTIONS
        }
        lines += ["/*", "    * FILE NAME: here", "*/", "", "/*", json.dumps(held, indent=4), "*/"]
        lines += ["", "/*", json.dumps({"motorName": "Linix", "motorDescription": ""}), "*/", ""]
    lines += [f"#ifndef __M{motor}_PMSM_APPCONFIG_H", f"#define __M{motor}_PMSM_APPCONFIG_H", ""]
    if inputs and commented:
        lines += comments(data)
    lines += [define(name, text, fixed=fixed, motor=motor) for name, text in data.constants.items()]
    lines += [f"#define M{motor}_POSPE_ENC_PULSES (1000)"]
    lines += ["/* USER INPUT START */", "#define AA 1", "/* USER INPUT END */", "#endif", ""]
    return "\n".join(lines)


def comments(data: Published) -> list[str]:
    """Inputs as the older age writes them."""
    lines = ["//Motor Parameters", "//" + "-" * 40]
    lines += [
        "//" + words.format(data.inputs[key])
        for key, words in COMMENTS.items()
        if key in data.inputs
    ]
    for heading, keys in LOOPS.items():
        lines += [f"//{heading}                    ", "//" + "-" * 40]
        for words, unit, key in zip(
            ("Loop bandwidth", "Loop attenuation", "Loop sample time"),
            ("Hz", "-", "sec"),
            keys,
            strict=True,
        ):
            if key in data.inputs:
                lines.append(f"//{words}                = {data.inputs[key]} [{unit}]")
    return lines
