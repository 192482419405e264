"""The devices that ship with the package, typed from public data sheets."""

from __future__ import annotations

from dqforge.machines.devices.device import DeviceModel
from dqforge.machines.devices.library_format import read_device_yaml
from dqforge.machines.files.library_files import LibraryFiles

_FILES = LibraryFiles("device", "devices")


def names() -> list[str]:
    """Names of the devices in the library, in alphabetical order."""
    return _FILES.names()


def read_text(name: str) -> bytes:
    """Bytes of a device in the library; raises `InputError` when there is none of this name."""
    return _FILES.read(name)


def load(name: str) -> DeviceModel:
    """Device from the library; raises `InputError` when there is none of this name."""
    return read_device_yaml(read_text(name), _FILES.source(name))
