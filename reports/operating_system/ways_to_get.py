"""How the programs that dqforge calls are got: the one table of packages, by who installs them."""

from __future__ import annotations

import shutil

from dqforge.machines.records import dataclass
from dqforge.reports.operating_system import system

EXTRA_CC = "python -m pip install 'dqforge[cc]'"


@dataclass(frozen=True, slots=True)
class Ways:
    """Packages that bring a program.

    Args:
        apt: Of Debian and Ubuntu.
        dnf: Of Fedora.
        brew: Command on macOS.
        winget: Identifier on Windows.
        pip: Command for every system, empty where there is none.
    """

    apt: tuple[str, ...]
    dnf: tuple[str, ...]
    brew: str
    winget: str
    pip: str = ""

    def here(self) -> str:
        """The command for this system; that for every system where none of it is known."""
        if system.WINDOWS:
            own = f"winget install {self.winget}"
        elif system.MACOS:
            own = self.brew
        elif shutil.which("apt-get"):
            own = f"sudo apt-get install {' '.join(self.apt)}"
        elif shutil.which("dnf"):
            own = f"sudo dnf install {' '.join(self.dnf)}"
        else:
            own = "" if self.pip else f"install {' and '.join(self.apt)}"
        return " or ".join(way for way in (self.pip, own) if way)


_GCC_OF_WINDOWS = "BrechtSanders.WinLibs.POSIX.UCRT"
_ARM = Ways(
    ("gcc-arm-none-eabi", "libnewlib-arm-none-eabi"),
    ("arm-none-eabi-gcc-cs", "arm-none-eabi-newlib"),
    "brew install --cask gcc-arm-embedded",
    "Arm.GnuArmEmbeddedToolchain",
)
_ARM_TOOLS = Ways(
    ("binutils-arm-none-eabi",), ("arm-none-eabi-binutils-cs",), _ARM.brew, _ARM.winget
)

# By program; compilers of the host by their language.
WAYS: dict[str, Ways] = {
    "c": Ways(("gcc",), ("gcc",), "xcode-select --install", _GCC_OF_WINDOWS, EXTRA_CC),
    "c++": Ways(("g++",), ("gcc-c++",), "xcode-select --install", _GCC_OF_WINDOWS, EXTRA_CC),
    "arm-none-eabi-gcc": _ARM,
    "arm-none-eabi-size": _ARM_TOOLS,
    "arm-none-eabi-objdump": _ARM_TOOLS,
    "qemu-system-arm": Ways(
        ("qemu-system-arm",),
        ("qemu-system-arm",),
        "brew install qemu",
        "SoftwareFreedomConservancy.QEMU",
    ),
    "cppcheck": Ways(("cppcheck",), ("cppcheck",), "brew install cppcheck", "Cppcheck.Cppcheck"),
}
