"""Files of one capture: a heading beside its samples, one file for each channel, packed ones."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from dqforge.machines.back_emf.columns import CaptureOptions, _pair, read_captures
from dqforge.machines.errors import InputError


@pytest.mark.parametrize(
    ("name", "there", "heading"),
    [
        ("cap.csv", "cap.Wfm.csv", "cap.csv"),
        ("cap.CSV", "cap.Wfm.CSV", "cap.CSV"),
        ("cap.Wfm.csv", "cap.csv", "cap.csv"),
        ("cap.wfm.csv", "cap.CSV", "cap.CSV"),
        ("cap.csv", "", None),
        ("cap.Wfm.csv", "", None),
        ("cap.mat", "cap.Wfm.csv", None),
    ],
)
def test_a_heading_beside_its_samples_is_found(name: str, there: str, heading: str | None) -> None:
    samples = there if heading == name else name
    assert _pair(name, lambda found: found == there) == (samples, heading)


TIME = np.arange(200) * 1e-5
VOLTS = np.sin(2.0 * np.pi * (150.0 * TIME + np.arange(3)[:, None] / 3.0))


def text(late: float, *channels: int) -> bytes:
    """Times in s and channels in mV of a table."""
    rows = np.vstack([TIME + late, 1e3 * VOLTS[list(channels)]]).T
    names = ",".join(f"CH{place} [mV]" for place in channels)
    lines = [",".join(f"{x:.12g}" for x in row) for row in rows]
    return "\n".join([f"time [s],{names}", *lines]).encode()


def test_files_of_the_channels_make_one_capture_and_say_how_far_they_are() -> None:
    content = {"a.csv": text(0.0, 0), "b.csv": text(4.9e-7, 1), "c.csv.gz": text(0.0, 2)}
    content["c.csv.gz"] = gzip.compress(content["c.csv.gz"][:900]) + gzip.compress(
        content["c.csv.gz"][900:]
    )
    told: list[float] = []
    options = CaptureOptions(scale=(1.0, 2.0, -10.0))
    found = read_captures(list(content), content.__getitem__, lambda _: False, options, told.append)
    np.testing.assert_allclose(found.voltages, VOLTS * [[1.0], [2.0], [-10.0]], atol=1e-9)
    assert found.time is not None
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    assert told == sorted(told)
    assert all(0.0 <= share <= 1.0 for share in told)
    assert not told or told[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (text(5.1e-7, 1, 2), "its samples lie up to 510 ns beside those of a.csv"),
        (text(0.0, 1, 2)[:3000].rpartition(b"\n")[0], "samples, a.csv has 200"),
    ],
)
def test_files_that_do_not_belong_together_are_refused(other: bytes, words: str) -> None:
    content = {"a.csv": text(0.0, 0), "b.csv": other}
    with pytest.raises(InputError, match=words):
        read_captures(list(content), content.__getitem__, lambda _: False, CaptureOptions())
    with pytest.raises(InputError, match="given twice"):
        read_captures(["a.csv", "a.csv"], content.__getitem__, lambda _: False, CaptureOptions())


def test_a_packed_file_that_is_cut_off_is_refused() -> None:
    packed = gzip.compress(text(0.0, 0, 1, 2))
    for content, words in ((packed[:-5], "cut off or damaged"), (b"time", "no gzip file")):
        files = {"a.csv.gz": content}
        with pytest.raises(InputError, match=words):
            read_captures(list(files), files.__getitem__, lambda _: False, CaptureOptions())
