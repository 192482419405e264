"""Names of headers that a written header would shadow, since a folder given with -I is
searched before the library's.

File systems of Windows and macOS take ``Math.h`` for ``math.h``, so that all names are
compared without their case.
"""

from __future__ import annotations

import re

_C = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbit
stdbool stdckdint stddef stdint stdio stdlib stdmchar stdnoreturn string tgmath threads time uchar wchar wctype
"""

_CPP = """
algorithm any array atomic barrier bit bitset cassert ccomplex cctype cerrno cfenv cfloat charconv chrono cinttypes
ciso646 climits clocale cmath codecvt compare complex concepts condition_variable contracts coroutine csetjmp csignal
cstdalign cstdarg cstdbool cstddef cstdint cstdio cstdlib cstring ctgmath ctime cuchar cwchar cwctype debugging deque
exception execution expected filesystem flat_map flat_set format forward_list fstream functional future generator
hazard_pointer hive initializer_list inplace_vector iomanip ios iosfwd iostream istream iterator latch limits linalg
list locale map mdspan memory memory_resource meta mutex new numbers numeric optional ostream print queue random ranges
ratio rcu regex scoped_allocator semaphore set shared_mutex simd source_location span spanstream sstream stack
stacktrace std stdexcept stdfloat stop_token streambuf string string_view strstream syncstream system_error
text_encoding thread tuple type_traits typeindex typeinfo unordered_map unordered_set utility valarray variant vector
version
"""

_SYSTEM = """
aio alloca aliases argp argz ar bits byteswap conio cpio cxxabi dirent direct dlfcn elf endian err error execinfo
fcntl features fmtmsg
fnmatch ftw getopt glob grp iconv immintrin intrin io langinfo libgen link malloc mem memory monetary mqueue ndbm net
netdb nl_types omp poll process pthread pwd quadmath regex regexp reent resolv sched search semaphore share spawn stab
strings syscall sysexits syslog syslimits tar term termios trace ucontext ulimit unistd unwind utime utmp utmpx values
varargs wait windows winsock2 wordexp newlib picolibc xlocale stdfix float_h yvals yvals_core corecrt vcruntime
crypt envz fstab fts gconv gshadow ifaddrs lastlog mcheck mntent nss obstack paths printf pty re_comp shadow sgtty
stdio_ext termcap termio thread_db ttyent
con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
"""

_VENDOR = """
main arm_math arm_math_types arm_math_memory arm_const_structs arm_common_tables arm_acle arm_cmse arm_fp16 arm_mve
arm_mve_types arm_neon arm_bf16 arm_cde arm_helium_utils arm_vec_math tz_context mpu_armv7 mpu_armv8 pmu_armv8
cachel1_armv7 rte_components rte_device task timers event_groups stream_buffer message_buffer croutine portable
projdefs deprecated_definitions atomic stack_macros mpu_wrappers portmacro portable list queue semphr tx_api tx_port
ux_api fx_api nx_api os_cpu os_cfg ucos_ii rtthread rtconfig rtdef zephyr device devicetree kernel
gpio tim adc dma usart spi i2c can fdcan rcc pwr flash crc rtc iwdg wwdg hrtim cordic fmac opamp comp dac
usb_device usbd_conf usbd_desc usb_host fatfs lwip ethernetif
pwm_curr_fdbk speed_pos_fdbk speed_torq_ctrl pid_regulator ramp_ext_mngr circle_limitation pqd_motorpowermeasurement
bus_voltage_sensor ntc_temperature_sensor open_loop revup_ctrl sto_speed_pos_fdbk virtual_speed_sensor digital_output
parameters_conversion drive_parameters power_stage_parameters pmsm_motor_parameters regular_conversion_manager
flux_weakening_ctrl max_torque_per_ampere feed_forward_ctrl encoder_speed_pos_fdbk hall_speed_pos_fdbk trajectory_ctrl
f2802x f2803x f2806x f28002x f28003x f28004x f2807x f2837xd f2837xs f2838x f28p55x f28p65x device_config driverlib
hw_types hw_memmap iqmathlib math_hal mathlib fpu clarke park ipark svgen ctrl est hal hal_data user types
fsl_common fsl_clock fsl_device_registers board pin_mux clock_config peripherals mlib gflib gmclib gdflib amclib gpclib
mlib_types fsl_adc fsl_pwm hal_gpio hal_entry bsp_api common_data r_ioport r_typedefs iodefine xmc_common xmc_gpio
cy_device cy_pdl cybsp cyhal sam samd21 saml21 same54 atmel_start definitions xc dspic33 p33exxxx avr interrupt
pico pico_stdlib hardware esp_system sdkconfig nrf nrfx nrf_gpio em_device em_chip renesas arduino wiring hardwareserial
wprogram wire simplefoc rtwtypes rt_nonfinite rtw_continuous rtw_solver multiword_types zero_crossing_types
tmwtypes builtin_typeid_types simstruc
"""

_FAMILIES = re.compile(
    r"stm32\w*|stm8\w*|system_\w+|startup_\w+|core_(?:c[amr]\w+|sc\d+|starmc\w*)|cmsis\w*|freertos\w*|arm_math\w*"
    r"|arm_nn\w*|mc_\w+|mcp_\w+|motorcontrol\w*|misra_\w+|fsl_\w+|nrf_\w+|nrfx_\w+|esp_\w+|lpc\d+\w*|mk[elv]\d+\w*"
    r"|mimxrt\w*|gd32\w*|at32\w*|apm32\w*|hc32\w*|hk32\w*|mm32\w*|ch32\w*|xmc[147]\w*|tle98\w*|tms320\w*|msp43\w*"
    r"|hw_\w+|r_cg_\w+|r_bsp\w*"
)

# Names that Windows keeps for devices, whatever their suffix.
_DEVICE = re.compile(r"con|prn|aux|nul|(?:com|lpt)[0-9]")
_STANDARD = frozenset((_C + _CPP).split())
_OTHERS = frozenset((_SYSTEM + _VENDOR).split())

# What follows the prefix in the names of written headers.
SUFFIXES = tuple(
    suffix + kind
    for suffix in (
        "",
        "_control",
        "_control_q15",
        "_control_q31",
        "_reference_q15",
        "_reference_q31",
        "_observer",
        "_observer_q15",
        "_observer_q31",
        "_speed_observer",
        "_speed_measurement",
        "_start_observer",
        "_startup",
        "_six_step",
        "_current_feedback",
        "_hardware",
        "_application",
        "_waveform",
        "_modulation",
        "_gains",
        "_weakening",
        "_frames",
    )
    for kind in ("", "_vectors")
)


def taken_header(prefix: str) -> str:
    """What a header is whose name one of the files of a prefix would have,
    such as ``the standard header math.h``.

    Empty where all names are free.
    """
    for suffix in SUFFIXES:
        name = (prefix + suffix).casefold()
        if _DEVICE.fullmatch(name):
            return f"{name}.h, which Windows keeps for a device"
        if name in _STANDARD:
            return f"{name}.h, a header of the standard library"
        if name in _OTHERS or _FAMILIES.fullmatch(name):
            return f"{name}.h, a common header of operating systems and vendors"
    # A prefix such as math_h is what remains of "math.h", and means the same.
    stem = re.sub(r"_(?:h|hpp|hxx)$", "", prefix.casefold())
    return taken_header(stem) if stem != prefix.casefold() else ""
