"""One synthetic back-EMF in the layouts that oscilloscopes write."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable, Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray

PSI = 9.549e-3  # Magnet flux linkage of the machine in Wb: 3 V peak of phase at 50 Hz electrical.
STEP = 2e-5
SAMPLES = 5000
START = -0.05
Files = dict[str, bytes]


def emf() -> tuple[FloatArray, FloatArray]:
    """Times in s, shape (N,), and the voltages of three phases with 4 % of a fifth harmonic,
    shape (3, N).
    """
    time: FloatArray = START + STEP * np.arange(SAMPLES, dtype=np.float64)
    omega = 2.0 * np.pi * 50.0
    theta = omega * time + 0.7 - np.arange(3)[:, None] * 2.0 * np.pi / 3.0
    noise = 0.01 * np.random.default_rng(3).standard_normal(theta.shape)
    return time, -omega * PSI * (np.sin(theta) + 0.04 * np.sin(5.0 * theta)) + noise


TIME, VOLTS = emf()


def rows(columns: Sequence[FloatArray], mark: str = ",", end: str = "") -> str:
    """Lines of columns of numbers."""
    return "".join(
        mark.join(f"{value:.7g}" for value in row) + end + "\n"
        for row in zip(*columns, strict=True)
    )


def german(text: str) -> str:
    """Numbers with decimal commas, cells parted by semicolons."""
    return text.replace(",", ";").replace(".", ",")


def beside(settings: Sequence[str], *columns: FloatArray) -> list[str]:
    """Rows of numbers with settings in the first cells of the first rows."""
    lines = rows(columns).splitlines()
    return [
        (settings[k] if k < len(settings) else ",,") + "," + line for k, line in enumerate(lines)
    ]


def tektronix_settings(channel: int) -> list[str]:
    return [
        f"Record Length,{SAMPLES},Points",
        f"Sample Interval,{STEP:.9e},s",
        "Trigger Point,2500,Samples",
        f"Source,CH{channel},",
        "Vertical Units,V,",
        "Horizontal Units,s,",
    ]


def tektronix_all() -> Files:
    blocks = [beside(tektronix_settings(k + 1), TIME, VOLTS[k]) for k in range(3)]
    return {
        "T0000ALL.CSV": "\n".join(",,".join(line) for line in zip(*blocks, strict=True)).encode()
        + b"\n"
    }


def tektronix_single() -> Files:
    names = [f"F0000CH{k}.CSV" for k in (1, 2, 3)]
    lines = [
        ",\n".join(beside(tektronix_settings(k + 1), TIME, VOLTS[k])) + ",\n" for k in range(3)
    ]
    return {name: text.encode() for name, text in zip(names, lines, strict=True)}


def tektronix_mdo() -> Files:
    head = (
        "Model,MDO3024\nFirmware Version,1.26\n\nWaveform Type,ANALOG,,\nHorizontal Units,s,,\n"
        f"Sample Interval,{STEP},,\nRecord Length,{SAMPLES},,\nVertical Units,V,V,V\n\n,,,\n"
        "TIME,CH1,CH2,CH3\n"
    )
    return {"tek0001ALL.csv": (head + rows([TIME, *VOLTS])).encode()}


def tektronix_without_times(titles: str) -> Files:
    head = f"Horizontal Units,s,,\nVertical Units,V,,\nSample Interval,{STEP},,\n\n{titles}"
    return {"tek.csv": (head + rows(list(VOLTS))).encode()}


def keysight() -> Files:
    return {
        "scope_0.csv": ("x-axis,1,2,3\nsecond,Volt,Volt,Volt\n" + rows([TIME, *VOLTS])).encode()
    }


def keysight_single() -> Files:
    head = (
        f"Revision:,0\nType:,raw\nPoints:,{SAMPLES}\nXInc:,{STEP:.6e}\nXOrg:,{START:.6e}\n"
        "YData range:,8\nData:,\n"
    )
    return {f"ch{k + 1}.csv": (head + rows([TIME, VOLTS[k]])).encode() for k in range(3)}


def rohde_schwarz_rtb() -> Files:
    return {"RTB1.CSV": ("in s,C1 in V,C2 in V,C3 in V\n" + rows([TIME, *VOLTS])).encode()}


def rohde_schwarz_rto() -> Files:
    head = (
        f"SignalFormat:Float:\nXStart:{START}:\nXStop:{-START}:\nResolution:{STEP:.6e}:\n"
        f"SignalRecordLength:{SAMPLES}:\nVerticalUnit:V:\nMultiChannelExport:C1W1,C2W1,C3W1:\n"
    )
    return {"cap.Wfm.csv": rows(list(VOLTS)).encode(), "cap.csv": head.encode()}


def lecroy() -> Files:
    head = (
        f"LECROYWR64Xi,Waveform\nSegments,1,SegmentSize,{SAMPLES}\nSegment,TrigTime\n"
        "Time,Ch1,Ch2,Ch3\n"
    )
    return {"LC00000.csv": (head + rows([TIME, *VOLTS])).encode()}


def lecroy_single() -> Files:
    head = (
        f"LECROYHDO4024,21525,Waveform\nSegments,1,SegmentSize,{SAMPLES}\n"
        "Segment,TrigTime,TimeSinceSegment1\n"
        "#1,12-Mar-2024 10:00:00,0\nTime,Ampl\n"
    )
    return {f"C{k + 1}Trace00000.csv": (head + rows([TIME, VOLTS[k]])).encode() for k in range(3)}


def picoscope() -> Files:
    head = "Time,Channel A,Channel B,Channel C\n(ms),(V),(V),(V)\n\n"
    return {"pico.csv": (head + rows([1e3 * TIME, *VOLTS])).encode()}


def picoscope_german() -> Files:
    head = "Zeit;Kanal A;Kanal B;Kanal C\n(ms);(mV);(mV);(mV)\n\n"
    return {"pico_de.csv": (head + german(rows([1e3 * TIME, *(1e3 * VOLTS)]))).encode()}


def picoscope_matlab() -> Files:
    from scipy.io import savemat

    stream = io.BytesIO()
    single = {
        name: volts.astype(np.float32)[:, None] for name, volts in zip("ABC", VOLTS, strict=True)
    }
    savemat(
        stream,
        {"Tstart": START, "Tinterval": STEP, "Length": float(SAMPLES), **single},
        do_compression=True,
    )
    return {"pico.mat": stream.getvalue()}


def matlab_matrix() -> Files:
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, {"data": np.stack([TIME, *VOLTS], axis=1)})
    return {"scope.mat": stream.getvalue()}


def matlab_4() -> Files:
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, {"t": TIME, "u": VOLTS}, format="4")
    return {"old.mat": stream.getvalue()}


def rigol_dho() -> Files:
    return {"RigolDS0.csv": ("Time(s),CH1(V),CH2(V),CH3(V)\n" + rows([TIME, *VOLTS])).encode()}


def rigol_ds1000z() -> Files:
    head = f"X,CH1,CH2,CH3,Start,Increment,\nSequence,Volt,Volt,Volt,{START:.6e},{STEP:.6e}\n"
    return {
        "NewFile1.csv": (
            head + rows([np.arange(SAMPLES, dtype=np.float64), *VOLTS], end=",,")
        ).encode()
    }


def rigol_mso5000(end: str = "") -> Files:
    head = f"CH1V,CH2V,CH3V,t0 ={START:.6e}, tInc = {STEP:.6e},\n"
    return {"RigolDS1.csv": (head + rows(list(VOLTS), end=end)).encode()}


def siglent(unit: str) -> Files:
    head = (
        f"Record Length,Analog:{SAMPLES}\nSample Interval,Analog:{STEP}\n"
        "Vertical Units,CH1:V CH2:V CH3:V\n"
        "Vertical Scale,CH1:1.00 CH2:1.00 CH3:1.00\nHorizontal Units,s\nModel Number,SDS1104X-E\n"
        f"Source,CH1,CH2,CH3\nSecond,{unit},{unit},{unit}\n"
    )
    return {"SDS00001.csv": (head + rows([TIME, *VOLTS])).encode()}


def yokogawa() -> Files:
    head = (
        '"//YOKOGAWA ASCII FILE FORMAT"\nModel,DL850\nBlockNumber,1\nTraceName,CH1,CH2,CH3\n'
        f"BlockSize,{SAMPLES},{SAMPLES},{SAMPLES}\nVUnit,V,V,V\nSampleRate,50000,50000,50000\n"
        f"HResolution,{STEP:.6E},{STEP:.6E},{STEP:.6E}\nHOffset,{START},{START},{START}\n"
        "HUnit,s,s,s\n\n"
    )
    return {
        "DL0001.csv": (
            head + "".join("," + line + "\n" for line in rows(list(VOLTS)).splitlines())
        ).encode()
    }


def saleae() -> Files:
    return {
        "analog.csv": ("Time [s],Channel 0,Channel 1,Channel 2\n" + rows([TIME, *VOLTS])).encode()
    }


def utf16_tabs() -> Files:
    return {"wide.txt": ("t [s]\tu\tv\tw\n" + rows([TIME, *VOLTS], mark="\t")).encode("utf-16")}


def gzipped() -> Files:
    return {"scope.csv.gz": gzip.compress(next(iter(keysight().values())), mtime=0)}


def two_and_one() -> Files:
    return {
        "two.csv": ("time_s,CH1_V,CH2_V\n" + rows([TIME, *VOLTS[:2]])).encode(),
        "one.csv": ("time_s,CH3_mV\n" + rows([TIME, 1e3 * VOLTS[2]])).encode(),
    }


LAYOUTS: dict[str, Callable[[], Files]] = {
    "Tektronix, three blocks side by side": tektronix_all,
    "Tektronix, a file per channel": tektronix_single,
    "Tektronix MDO": tektronix_mdo,
    "Tektronix without times": lambda: tektronix_without_times("CH1,CH2,CH3\n"),
    "Tektronix without times and titles": lambda: tektronix_without_times(""),
    "Keysight": keysight,
    "Keysight Infiniium, a file per channel": keysight_single,
    "Rohde & Schwarz RTB": rohde_schwarz_rtb,
    "Rohde & Schwarz RTO": rohde_schwarz_rto,
    "LeCroy": lecroy,
    "LeCroy, a file per channel": lecroy_single,
    "PicoScope": picoscope,
    "PicoScope, German": picoscope_german,
    "PicoScope, MATLAB": picoscope_matlab,
    "MATLAB, a matrix": matlab_matrix,
    "MATLAB 4": matlab_4,
    "Rigol DHO": rigol_dho,
    "Rigol DS1000Z": rigol_ds1000z,
    "Rigol MSO5000": rigol_mso5000,
    "Rigol MSO5000, empty cells": lambda: rigol_mso5000(",,"),
    "Siglent": lambda: siglent("Value"),
    "Siglent, volts": lambda: siglent("Volt"),
    "Yokogawa DL": yokogawa,
    "Saleae": saleae,
    "UTF-16 with tabs": utf16_tabs,
    "gzip": gzipped,
    "two channels and one": two_and_one,
}
