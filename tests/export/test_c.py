"""The exported C answers as Python does, for every operator that can be stepped."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skhyst.export import to_c

sys.path.insert(0, str(Path(__file__).parents[1] / "operators"))
from operator_cases import DT, OPERATORS, make_drive  # noqa: E402

FLAGS = "-std=c99 -Wall -Wextra -Werror -pedantic -fsanitize=address,undefined".split()


def compiled(folder, names, *flags):
    """Compile programs into one, and return what each printed, by name."""
    lines = ["#include <stdio.h>"]
    for name in names:
        lines += [f"#define main {name}_main", f'#include "{name}.c"', f'#include "{name}_test.c"']
        lines += ["#undef main"]
    calls = "".join(f"    failed += {name}_main();\n" for name in names)
    lines += ["int main(void)\n{\n    int failed = 0;", calls + "    return failed != 0;\n}\n"]
    (folder / "all.c").write_text("\n".join(lines))
    subprocess.run(["cc", *flags, "all.c", "-o", "all", "-lm"], cwd=folder, check=True)
    done = subprocess.run(["./all"], cwd=folder, capture_output=True, text=True)
    return done


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_every_operator(tmp_path, dtype):
    u, names = make_drive(), {}
    for k, (case, operator) in enumerate(OPERATORS.items()):
        try:
            to_c(operator, tmp_path, f"case{k}", dtype, dt=DT, u0=u[0], drive=u)
        except NotImplementedError:
            continue
        names[f"case{k}"] = case
    done = compiled(tmp_path, names, *FLAGS)
    print(done.stderr)
    for l in done.stdout.splitlines():
        n, _, r = l.partition(":")
        if float(r.split()[0]) > float(r.split()[-2]):
            print(names[n], r)
    assert done.returncode == 0
