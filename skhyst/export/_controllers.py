"""Run exported programs on emulated controllers, and measure their memory and time.

Each target has a compiler and an emulator. The firmware takes one sample from the host, makes one
step and returns the output, the status and the number of instructions of the step. QEMU counts
instructions (``-icount``): each takes 2^6 ns on the controller's timer. For AVR, a program
(``avr.c``) that is built with the library of simavr counts instructions and cycles. On x86-64 the
processor's trap flag counts instructions, without emulation.
"""

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from string import Template

import numpy as np
import pandas as pd

_SYNC = b"\x55"  # sent before the first sample: the firmware ignores earlier bytes
_SAMPLES = 100  # samples of the test's drive with which the time is measured
_FLAGS = ("-std=gnu99", "-Os", "-ffunction-sections", "-fdata-sections", "-fno-common")
# QEMU loads the segments of a program to their addresses: nothing is copied at the start
_BARE = (
    *("-nostartfiles", "--specs=nosys.specs", "-Wl,-e_start,--gc-sections,-uvectors"),
    "-Wl,--section-start=.vectors=0,-Ttext=0x100,-Tdata=0x20000000",
)
_QEMU = (
    *("-nographic", "-monitor", "none", "-chardev", "stdio,id=host,signal=off"),
    *("-serial", "chardev:host", "-icount", "shift=6,sleep=off", "-kernel"),
)
_SIMAVR = (
    *("cc", "-O2", "-o", "emulator", str(Path(__file__).with_name("avr.c"))),
    *("-lsimavr", "-lelf"),
)
_NUMBERS = {"double": np.float64, "float": np.float32, "int32_t": np.int32}


@dataclass(frozen=True)
class _Target:
    """A controller that programs are compiled for and run on.

    ``options`` are those of the compiler, ``linked`` those of linking, ``runs`` the command of the
    emulator, ``ticks`` those of the controller's timer per instruction, and ``built`` the command
    that builds the emulator, if it has to be built first.
    """

    compiler: str
    options: tuple
    linked: tuple
    runs: tuple
    ticks: float
    built: tuple = ()

    def compile(self, folder, source, *more):
        """Compile a source in a folder; return whether it succeeded, and the messages."""
        command = [self.compiler, *_FLAGS, *self.options, *more, str(source)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        return done.returncode == 0, done.stderr


TARGETS = {
    "Cortex-M0": _Target(
        "arm-none-eabi-gcc",
        ("-mcpu=cortex-m0", "-mthumb"),
        _BARE,
        ("qemu-system-arm", "-M", "microbit", *_QEMU),
        0.064 * 16,  # us of an instruction, MHz of its timer
    ),
    "Cortex-M4F": _Target(
        "arm-none-eabi-gcc",
        ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
        _BARE,
        ("qemu-system-arm", "-M", "mps2-an386", *_QEMU),
        0.064 * 25,
    ),
    "AVR": _Target(
        "avr-gcc",
        ("-mmcu=atmega2560",),
        ("-Wl,--gc-sections",),
        ("./emulator",),
        1.0,
        _SIMAVR,
    ),
    "x86-64": _Target("x86_64-linux-gnu-gcc", ("-m64", "-mno-red-zone"), (), (), 1.0),
}
_FIRMWARE = Template("""\
#include <stdint.h>
#include <string.h>
#if defined(__x86_64__)
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>
static volatile uint32_t count;
static void trapped(int signal) { (void)signal; count++; }
static void start(void) { signal(SIGTRAP, trapped); }
static uint8_t get(void)
{
    uint8_t byte;
    if (read(0, &byte, 1) != 1) {
        exit(0);
    }
    return byte;
}
static void put(uint8_t byte)
{
    if (write(1, &byte, 1) != 1) {
        exit(1);
    }
}
#define FLAGS(what) __asm__ volatile("pushfq; " what ", (%%rsp); popfq" ::: "cc", "memory")
#define BEGIN count = 0; FLAGS("orq $$0x100")
#define END(n) FLAGS("andq $$~0x100"); n[0] = count; n[1] = 0
#elif defined(__AVR__)
#include <avr/io.h>
static void start(void) {}
static uint8_t asked(uint8_t what)
{
    GPIOR1 = what;
    return GPIOR2;
}
static uint8_t get(void) { return asked(0); }
static void put(uint8_t byte) { GPIOR0 = byte; }
static uint32_t word(uint8_t first)
{
    uint32_t word = 0;
    uint8_t i;
    for (i = 0; i < 4; i++) {
        word |= (uint32_t)asked(first + i) << 8 * i;
    }
    return word;
}
#define BEGIN GPIOR1 = 1
#define END(n) n[0] = word(2); n[1] = word(6)
#else /* Cortex-M */
#define REGISTER(at) (*(volatile uint32_t *)(at))
int main(void);
void _start(void);
__attribute__((section(".vectors"))) const uintptr_t vectors[16] = {
    0x20004000, (uintptr_t)_start}; /* stack at the end of 16 kB */
void _start(void)
{
#ifdef __ARM_FP
    REGISTER(0xe000ed88) |= 0xf00000; /* floating point on */
#endif
    main();
}
#define SYSTICK(control) REGISTER(0xe000e010) = (control)
#if __ARM_ARCH == 6 /* nRF51 */
#define TIMED(control)
static void start_serial(void)
{
    SYSTICK(5); /* by the clock of the processor */
    REGISTER(0x40002500) = 4; /* enabled */
    REGISTER(0x40002000) = 1; /* receive */
    REGISTER(0x40002008) = 1; /* transmit */
}
static uint8_t get(void)
{
    while (REGISTER(0x40002108) == 0) {
    }
    REGISTER(0x40002108) = 0;
    return (uint8_t)REGISTER(0x40002518);
}
static void put(uint8_t byte)
{
    REGISTER(0x4000211c) = 0;
    REGISTER(0x4000251c) = byte;
    while (REGISTER(0x4000211c) == 0) {
    }
}
#else /* CMSDK */
/* It sleeps between samples: no timer wakes it, and the interrupt of a byte is not served. */
#define TIMED(control) SYSTICK(control)
static void start_serial(void)
{
    __asm__ volatile("cpsid i");
    REGISTER(0x40004010) = 16; /* cycles of a bit */
    REGISTER(0x40004008) = 11; /* receive, with its interrupt, and transmit */
    REGISTER(0xe000e100) = 1; /* which wakes */
}
static uint8_t get(void)
{
    uint8_t byte;
    while ((REGISTER(0x40004004) & 2) == 0) {
        __asm__ volatile("wfi");
    }
    byte = (uint8_t)REGISTER(0x40004000);
    REGISTER(0x4000400c) = 2; /* the interrupt is over */
    REGISTER(0xe000e280) = 1; /* and no longer pending */
    return byte;
}
static void put(uint8_t byte)
{
    while (REGISTER(0x40004004) & 1) {
    }
    REGISTER(0x40004000) = byte;
}
#endif
static void start(void)
{
    REGISTER(0xe000e014) = 0xffffff; /* SysTick counts down from here */
    REGISTER(0xe000e018) = 0;
    start_serial();
}
#define BEGIN TIMED(5); uint32_t first = REGISTER(0xe000e018)
#define END(n) n[0] = (first - REGISTER(0xe000e018)) & 0xffffff; n[1] = 0; TIMED(4)
#endif
#include "$name.h"

static void exchange(void *data, int n, int puts)
{
    uint8_t *bytes = data;
    int k;
    for (k = 0; k < n; k++) {
        if (puts) {
            put(bytes[k]);
        } else {
            bytes[k] = get();
        }
    }
}

int main(void)
{
    static ${name}_state state;
    static $number u[${name}_N_INPUTS];
    $number y;
    uint32_t words[3], empty[2];
    start();
    ${name}_init(&state);
    while (get() != $sync) {
    }
    {
        BEGIN;
        END(empty);
    }
    for (;;) {
        exchange(u, sizeof u, 0);
        {
            BEGIN;
            y = ${name}_step(&state, $input);
            END(words);
        }
        words[0] -= empty[0];
        words[1] -= empty[1];
        words[2] = ${name}_status(&state);
        exchange(&y, sizeof y, 1);
        exchange(words, sizeof words, 1);
    }
}
""")


class EmulatedController:
    """A program of :func:`to_c` that runs on an emulated controller, sample by sample.

    It replaces the stepper of the model, as in :func:`~skhyst.control.simulate_loop`: the loop then
    contains the emulated processor. Use it in a ``with`` statement, or close it. It needs a
    compiler and an emulator: ``apt-get install
    gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm`` for Cortex-M, ``gcc-avr avr-libc
    simavr libsimavr-dev libelf-dev`` for AVR; programs for x86-64 run on the processor itself.

    Parameters
    ----------
    folder : str or Path
        Folder of the program.
    name : str
        Name of the program.
    target : {"Cortex-M4F", "Cortex-M0", "AVR", "x86-64"}, default="Cortex-M4F"
        The controllers that are emulated: ARM MPS2 with AN386, micro:bit, ATmega2560.

    Attributes
    ----------
    status : int
        Status of the last sample, see :func:`to_c`.
    instructions : float
        Number of instructions of the last step, with an error of about one.
    cycles : float
        Clock cycles of the last step; NaN except for AVR, whose emulator alone counts them.

    Raises
    ------
    FileNotFoundError
        If there is no such program, or the compiler or the emulator is not installed.
    RuntimeError
        If the program cannot be compiled for the target, as one in ``float64`` for AVR, or does not
        fit into its memory; from :meth:`step` if it has stopped.

    See Also
    --------
    to_c : Write such a program.
    program_sizes : Memory and time of a program.

    Examples
    --------
    >>> import tempfile
    >>> from skhyst.export import EmulatedController, to_c
    >>> from skhyst.hysteresis import BacklashOperator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = to_c(BacklashOperator(0.2), folder, "gear", dt=1e-3)
    ...     with EmulatedController(folder, "gear") as gear:  # doctest: +SKIP
    ...         print(gear.step(1.0), gear.instructions)
    0.8 283.0
    """

    def __init__(self, folder, name, target="Cortex-M4F"):
        if target not in TARGETS:
            raise ValueError(
                f"The 'target' parameter of EmulatedController must be one of {sorted(TARGETS)}. "
                f"Got {target!r} instead."
            )
        self.status, self.instructions, self.cycles = 0, np.nan, np.nan
        self._target = TARGETS[target]
        self._process, emulated = None, self._target
        source = program_source(folder, name)
        for tool in (emulated.compiler, *(emulated.built or emulated.runs)[:1]):
            if shutil.which(tool) is None:
                raise FileNotFoundError(f"There is no {tool}, which {target} needs.")
        header = source.with_suffix(".h").read_text()
        number_type, arguments = re.search(rf"^(\w+) {name}_step\((.*)\);", header, re.M).groups()
        n_inputs = int(re.search(rf"{name}_N_INPUTS (\d+)", header)[1])
        self._number, self._shape = np.dtype(_NUMBERS[number_type]), (n_inputs,)
        # a step takes several inputs as an array, a single one as a number
        text = _FIRMWARE.substitute(
            name=name, number=number_type, input="u" if "*u" in arguments else "u[0]", sync=_SYNC[0]
        )
        self._place = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        build_folder = Path(self._place.name)
        (build_folder / "firmware.c").write_text(text)
        command = ("-o", "firmware", str(source), f"-I{source.parent}", *emulated.linked)
        compiled, messages = emulated.compile(build_folder, "firmware.c", *command, "-lm")
        if not compiled:
            self.close()
            raise RuntimeError(f"The program cannot be compiled for {target}: {messages.strip()}")
        if emulated.built:
            built = subprocess.run(emulated.built, cwd=build_folder, capture_output=True, text=True)
            if built.returncode:
                self.close()
                raise FileNotFoundError(
                    f"There is no emulator for {target}: {built.stderr.strip()}"
                )
        self._process = subprocess.Popen(
            [*emulated.runs, str(build_folder / "firmware")],
            cwd=build_folder,
            **dict.fromkeys(("stdin", "stdout"), subprocess.PIPE),
            stderr=subprocess.DEVNULL,  # a pipe that nobody reads would fill up and block
            bufsize=0,
        )
        self._process.stdin.write(_SYNC)

    def step(self, u):
        """Return the output for one sample.

        Parameters
        ----------
        u : float or array-like of shape (n_inputs,)
            Input, in its units.

        Returns
        -------
        float
            Output, in its units.

        Raises
        ------
        ValueError
            If there are more or fewer inputs than the program has.
        RuntimeError
            If the program has stopped.
        """
        u = np.asarray(u, dtype=self._number).ravel()
        if u.shape != self._shape:
            raise ValueError(
                f"The 'u' parameter of step must have {self._shape[0]} numbers. Got {u.size} "
                "instead."
            )
        answer = b""
        try:
            self._process.stdin.write(u.tobytes())
            # the output, then three words of 32 bits; a pipe may return them in pieces
            while (n_missing := self._number.itemsize + 12 - len(answer)) > 0:
                if not (received := self._process.stdout.read(n_missing)):
                    raise BrokenPipeError
                answer += received
        except BrokenPipeError:
            raise RuntimeError("The program on the emulated controller has stopped.") from None
        ticks, cycles, status = np.frombuffer(answer[-12:], dtype="<u4")
        self.instructions, self.status = ticks / self._target.ticks, int(status)
        self.cycles = float(cycles) if cycles else np.nan
        return float(np.frombuffer(answer[:-12], dtype=self._number)[0])

    def close(self):
        """Stop the controller."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
        self._place.cleanup()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()


def program_source(folder, name):
    """Return the path of a program's source."""
    source = Path(folder, f"{name}.c").resolve()
    if not source.exists():
        raise FileNotFoundError(f"There is no program {source}.")
    return source


def program_sizes(folder, name) -> pd.DataFrame:
    """Return the memory and the time that a program of :func:`to_c` takes on typical controllers.

    It is compiled for size by each cross-compiler that is found: ``arm-none-eabi-gcc``,
    ``avr-gcc``, ``x86_64-linux-gnu-gcc``, and run as an :class:`EmulatedController` over the first
    100 samples of its test.

    Parameters
    ----------
    folder : str or Path
        Folder of the program.
    name : str
        Name of the program.

    Returns
    -------
    DataFrame of shape (n_targets, 6)
        By target: ``flash``, code and tables, without the functions of the math library and of
        floating point in software; ``state``, RAM of one device; ``stack``, of the deepest function
        alone, all in bytes; ``instructions`` and ``most_instructions`` of a step, the mean and the
        largest over the samples, with those of the library; ``most_cycles``, the largest number of
        clock cycles, of AVR alone: on a Cortex-M most instructions take one. NaN where the compiler
        or the emulator is not found or refuses the program, as one whose ``double`` has 32 bits
        does.

    Raises
    ------
    FileNotFoundError
        If there is no such program.

    See Also
    --------
    to_c : Write such a program.
    EmulatedController : Run it sample by sample.

    Examples
    --------
    >>> import tempfile
    >>> from skhyst.export import program_sizes, to_c
    >>> from skhyst.hysteresis import BacklashOperator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = to_c(BacklashOperator(0.2), folder, "gear", "float32", dt=1e-3)
    ...     sizes = program_sizes(folder, "gear")
    >>> list(sizes.columns)
    ['flash', 'state', 'stack', 'instructions', 'most_instructions', 'most_cycles']
    """
    source = program_source(folder, name)
    rows = [
        {"target": key, **_size(source, controller), **_time(source, key)}
        for key, controller in TARGETS.items()
    ]
    return pd.DataFrame(rows).set_index("target").rename_axis(None)


def _time(source, target):
    """Return the instructions and cycles of a step, None where the program cannot be run."""
    counts = []
    try:
        with EmulatedController(source.parent, source.stem, target) as controller:
            for u in _test_inputs(source):
                controller.step(u)
                counts.append((controller.instructions, controller.cycles))
    except (FileNotFoundError, RuntimeError):
        return dict.fromkeys(("instructions", "most_instructions", "most_cycles"))
    most_instructions, cycles = np.round(np.max(counts, axis=0))
    mean = np.round(np.mean(counts, axis=0)[0])
    return {"instructions": mean, "most_instructions": most_instructions, "most_cycles": cycles}


def _test_inputs(source):
    """Return the first inputs (n_samples, n_inputs) of the test of a program."""
    text = source.with_name(f"{source.stem}_test.c").read_text()
    rows = text[text.index("_inputs[N_SAMPLES]") :].split("= {\n", 1)[1].split("\n};", 1)[0]
    rows = [re.findall(r"[-+.\de]+", row) for row in rows.splitlines()[:_SAMPLES]]
    return np.array(rows, dtype=float)


def _size(source, target):
    """Return flash, state and stack in bytes, None where the program cannot be compiled."""
    unknown = dict.fromkeys(("flash", "state", "stack"))
    if shutil.which(target.compiler) is None:
        return unknown
    with tempfile.TemporaryDirectory() as folder:
        # the state is the only object with data of its own: its size is that of .bss
        probe = Path(folder, "state.c")
        probe.write_text(f'#include "{source.stem}.h"\n{source.stem}_state one;\n')
        for file in (source, probe):
            if not target.compile(folder, file, "-c", "-fstack-usage", f"-I{source.parent}")[0]:
                return unknown
        tool = f"{target.compiler.removesuffix('gcc')}size"
        sizes = []
        for file in (f"{source.stem}.o", "state.o"):
            done = subprocess.run([tool, file], cwd=folder, capture_output=True, text=True)
            sizes.append([int(x) for x in done.stdout.splitlines()[1].split()[:3]])
        lines = Path(folder, f"{source.stem}.su").read_text().splitlines()
        stack = max(int(line.split("\t")[1]) for line in lines)
    return {"flash": sizes[0][0] + sizes[0][1], "state": sizes[1][2], "stack": stack}
