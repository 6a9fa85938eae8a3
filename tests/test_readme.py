"""The five lines of the README run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow

README = Path(__file__).parents[1] / "README.md"


def test_five_lines(tmp_path):
    pytest.importorskip("jinja2", reason="the report needs the extra plot")
    rng = np.random.default_rng(0)
    time = np.arange(1500) * 1e-3
    voltage = 20.0 * np.sin(2 * np.pi * 3.0 * time) * np.linspace(0.3, 1.0, 1500)
    position = 0.1 * np.minimum(voltage, 12.0) + 0.002 * rng.normal(size=1500)
    rows = np.column_stack([time, voltage, position])
    header = "time,voltage,position"
    np.savetxt(tmp_path / "recording.csv", rows, delimiter=",", header=header, comments="")
    code = re.search(r"## Five lines\n\n```python\n(.*?)```", README.read_text(), re.DOTALL)[1]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "saturation" in done.stdout
    assert "<html" in (tmp_path / "report.html").read_text()
