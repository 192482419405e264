"""Device data from files: transistordatabase (JSON), PLECS (XML), and the YAML of the library."""

from __future__ import annotations

from pathlib import PurePath

from dqforge.machines.devices.device import DeviceModel
from dqforge.machines.errors import InputError

MAX_BYTES = 5_000_000


def read_device(content: bytes, source: str) -> DeviceModel:
    """Device in the bytes of a file.

    Args:
        content: Bytes of the file, at most 5 MB.
        source:
            Its name; the suffix chooses the format: .json (transistordatabase), .xml (PLECS),
            .yaml or .yml (dqforge).

    Raises:
        InputError: The file is none of its format or its data are not sound; with the file and the
            place in it.
    """
    if len(content) > MAX_BYTES:
        message = (
            f"the file has more than {MAX_BYTES // 1_000_000} MB, devices have a few hundred kB"
        )
        raise InputError(f"{message}; export one device alone", source=source)
    suffix = PurePath(source).suffix.lower()
    # Each reader brings libraries that the others do not need.
    if suffix == ".json":
        from dqforge.machines.devices.transistordatabase import read_transistordatabase

        return read_transistordatabase(content, source)
    if suffix == ".xml":
        from dqforge.machines.devices.plecs import read_plecs

        return read_plecs(content, source)
    if suffix in (".yaml", ".yml"):
        from dqforge.machines.devices.library_format import read_device_yaml

        return read_device_yaml(content, source)
    message = f"cannot read a device from a file with the suffix {suffix!r}"
    raise InputError(
        f"{message}; write .json (transistordatabase), .xml (PLECS) or .yaml", source=source
    )
