"""The devices that ship with the package, typed from public data sheets."""

from __future__ import annotations

import re
from importlib import resources
from importlib.resources.abc import Traversable

from dqforge.machines.devices.device import DeviceModel
from dqforge.machines.devices.library_format import read_device_yaml
from dqforge.machines.errors import InputError
from dqforge.machines.wording import close_matches, shown

_SUFFIX = ".yaml"


# Names are matched before they meet the file system, so none can leave the folder.
_NAME = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*")


def _folder() -> Traversable:
    return resources.files("dqforge.machines") / "library" / "devices"


def names() -> list[str]:
    """Names of the devices in the library, in alphabetical order."""
    files = (entry.name for entry in _folder().iterdir())
    return sorted(name.removesuffix(_SUFFIX) for name in files if name.endswith(_SUFFIX))


def read_text(name: str) -> bytes:
    """Bytes of a device in the library; raises `InputError` when there is none of this name."""
    known = names()
    if not _NAME.fullmatch(name) or name not in known:
        matches = close_matches(name, known) or [part for part in known if name and name in part]
        hint = (
            f"did you mean {' or '.join(matches[:2])}?"
            if matches
            else f"there are {', '.join(known)}"
        )
        raise InputError(f"no device {shown(name)} in the library; {hint}")
    return (_folder() / (name + _SUFFIX)).read_bytes()


def load(name: str) -> DeviceModel:
    """Device from the library; raises `InputError` when there is none of this name."""
    return read_device_yaml(read_text(name), name + _SUFFIX)
