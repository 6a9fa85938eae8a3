"""Memory of an exported program on typical controllers, as their compilers lay it out."""

import shutil
import subprocess
import tempfile
from pathlib import Path

import pandas as pd

# compiler, its options, and its tool that tells sizes
_TARGETS = {
    "Cortex-M0": ("arm-none-eabi-gcc", ("-mcpu=cortex-m0", "-mthumb")),
    "Cortex-M4F": (
        "arm-none-eabi-gcc",
        ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
    ),
    "AVR": ("avr-gcc", ("-mmcu=atmega2560",)),
    "x86-64": ("x86_64-linux-gnu-gcc", ("-m64",)),
}
_FLAGS = (
    "-std=c99",
    "-Os",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-common",
    "-c",
    "-fstack-usage",
)


def program_sizes(folder, name) -> pd.DataFrame:
    """Return how much memory a program of :func:`to_c` takes on typical controllers.

    It is compiled for size by each cross-compiler that is found: ``arm-none-eabi-gcc``,
    ``avr-gcc``, ``x86_64-linux-gnu-gcc``.

    Parameters
    ----------
    folder : str or Path
        Where the program is.
    name : str
        Of the program.

    Returns
    -------
    DataFrame of shape (n_targets, 3)
        By target: ``flash``, code and tables, without the functions of the math library and of
        floating point in software; ``state``, RAM of one device; ``stack``, of the deepest function
        alone, all in bytes. NaN where the compiler is not found or refuses the program, as one
        whose ``double`` has 32 bits does.

    Raises
    ------
    FileNotFoundError
        If there is no such program.

    Examples
    --------
    >>> import tempfile
    >>> from skhyst.export import program_sizes, to_c
    >>> from skhyst.hysteresis import BacklashOperator
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = to_c(BacklashOperator(0.2), folder, "gear", "float32", dt=1e-3)
    ...     sizes = program_sizes(folder, "gear")
    >>> list(sizes.columns)
    ['flash', 'state', 'stack']
    """
    source = Path(folder, f"{name}.c").resolve()
    if not source.exists():
        raise FileNotFoundError(f"There is no program {source}.")
    rows = {target: _size(source, name, *own) for target, own in _TARGETS.items()}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["flash", "state", "stack"])


def _size(source, name, compiler, options):
    """Return flash, state and stack in bytes, None where they are not known."""
    if shutil.which(compiler) is None:
        return None, None, None
    with tempfile.TemporaryDirectory() as folder:
        # the state is the only object with data of its own: its size is that of .bss
        probe = Path(folder, "state.c")
        probe.write_text(f'#include "{name}.h"\n{name}_state one;\n')
        for file in (source, probe):
            command = [compiler, *_FLAGS, *options, f"-I{source.parent}", str(file)]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            if done.returncode:
                return None, None, None
        tool = f"{compiler.removesuffix('gcc')}size"
        sizes = []
        for file in (f"{source.stem}.o", "state.o"):
            told = subprocess.run([tool, file], cwd=folder, capture_output=True, text=True)
            sizes.append([int(x) for x in told.stdout.splitlines()[1].split()[:3]])
        lines = Path(folder, f"{source.stem}.su").read_text().splitlines()
        stack = [int(line.split("\t")[1]) for line in lines]
    return sizes[0][0] + sizes[0][1], sizes[1][2], max(stack)
