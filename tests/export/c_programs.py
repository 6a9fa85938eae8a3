"""Programs that were written as C, compiled and run."""

import re
import subprocess

FLAGS = (
    *("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-pedantic"),
    *("-Wdouble-promotion", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
    # which double the time of the compiler; every access to memory is checked by its address
    "-fno-sanitize=null,alignment,object-size,pointer-overflow",
)


def error_of(folder, name):
    """Run the test program and return the error that it tells."""
    command = ["cc", *FLAGS, f"{name}.c", f"{name}_test.c", "-o", name, "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run(folder / name, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return float(re.search(r": (\S+) of", done.stdout)[1])
