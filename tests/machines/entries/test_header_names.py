"""Prefixes whose headers would shadow those of the C and C++ libraries or of vendors."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.entries.rules import SUFFIXES, EntryError, check_prefix, taken_header
from dqforge.machines.errors import InputError
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import header_kinds

# C23 (N3220, annex B) and C++23 (table of headers), written down here once more.
STANDARD = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
algorithm any array atomic barrier bit bitset charconv chrono codecvt compare concepts condition_variable coroutine
deque exception execution expected filesystem flat_map flat_set format forward_list fstream functional future
generator initializer_list iomanip ios iosfwd iostream istream iterator latch list map mdspan memory memory_resource
mutex numbers numeric optional ostream print queue random ranges ratio regex scoped_allocator semaphore set
shared_mutex source_location span spanstream sstream stack stacktrace stdexcept stdfloat stop_token streambuf
string_view strstream syncstream system_error thread tuple type_traits typeindex typeinfo unordered_map unordered_set
utility valarray variant vector version cassert ccomplex cctype cerrno cfenv cfloat cinttypes ciso646 climits clocale
cmath csetjmp csignal cstdalign cstdarg cstdbool cstddef cstdint cstdio cstdlib cstring ctgmath ctime cuchar cwchar
cwctype
"""
VENDOR = """
main cmsis_gcc cmsis_compiler cmsis_os cmsis_os2 arm_math arm_const_structs core_cm0plus core_cm4 core_cm7 core_cm33
stm32f4xx stm32f4xx_hal stm32g4xx_hal_conf stm32g431xx stm32h7xx_it system_stm32f4xx FreeRTOS FreeRTOSConfig task
queue semphr timers mc_config mc_api mc_interface mc_math mc_tasks mc_type mc_parameters drive_parameters unistd
pthread fsl_common nrf_gpio gd32f30x rtwtypes iqmathlib device driverlib
"""


@pytest.mark.parametrize("name", [*STANDARD.split(), *VENDOR.split()])
def test_names_of_headers_are_refused_in_every_case(name: str) -> None:
    for prefix in (name, name.upper(), name.capitalize(), f"{name}_h"):
        with pytest.raises(EntryError) as caught:
            check_prefix(prefix)
        hint = re.search(r"write e\.g\. (\w+)$", caught.value.message)
        assert hint is not None
        assert check_prefix(hint[1]) == hint[1]


@pytest.mark.parametrize("name", ["math", "stdint", "stdlib"])
def test_a_design_names_the_place(name: str) -> None:
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    changed = re.sub(r"prefix: \w+", f"prefix: {name}", text)
    with pytest.raises(InputError, match=rf"shadows {name}\.h") as caught:
        load_text(changed.encode(), "f.yaml")
    assert (caught.value.line or 0) > 1
    with pytest.raises(InputError, match="not an identifier"):
        load_text(changed.replace(f"prefix: {name}", f"prefix: {name}.h").encode(), "f.yaml")


@pytest.mark.parametrize(
    "name", ["motor", "motor1", "ipm100", "mathis", "bench", "Mot", "maths", "stdint1", "timer"]
)
def test_other_names_are_free(name: str) -> None:
    assert check_prefix(name) == name


def test_prefixes_of_the_library_are_free() -> None:
    for name in catalogue.names():
        assert not taken_header(catalogue.load(name).export.prefix)


def test_the_names_of_all_written_files_are_looked_at() -> None:
    written = {file for kind in header_kinds(CAPABILITIES) for file in kind.file_names("x")}
    assert written | {"x.h", "x_vectors.h"} <= {f"x{suffix}.h" for suffix in SUFFIXES}


def test_a_file_behind_the_prefix_counts_too() -> None:
    # "speed" writes speed_control.h and so on, which are free; "system" would
    # write names as CMSIS has them.
    assert check_prefix("speed") == "speed"
    with pytest.raises(EntryError, match=r"shadows system_\w+\.h"):
        check_prefix("system")


def test_every_header_of_the_compiler_is_known() -> None:
    """Headers in the library's own folder that C99 and C++11 programs can include by a plain
    name.
    """
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    told = subprocess.run(
        [compiler, "-E", "-x", "c++", "-v", "/dev/null"],
        capture_output=True,
        text=True,
        check=False,
    )
    folders = re.findall(r"^ (/\S*c\+\+/[0-9.]+)$", told.stderr, re.MULTILINE)
    names = [path.name for path in Path(folders[0]).iterdir() if path.is_file()] if folders else []
    missed = [name for name in names if "." not in name and not taken_header(name)]
    assert not missed


@pytest.mark.parametrize("prefix", ["con", "AUX", "nul", "com1", "lpt9"])
def test_names_of_devices_of_windows_are_taken(prefix: str) -> None:
    assert "which Windows keeps for a device" in taken_header(prefix)
    assert taken_header(f"{prefix}x") == ""
