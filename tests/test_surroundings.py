"""A search sends nothing, and finds the same wherever and whenever it runs."""

import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

pytestmark = pytest.mark.slow

WATCHED = """
import sys
sent = []
sys.addaudithook(lambda event, own: event.startswith(("socket.", "urllib.")) and sent.append(event))
from skhyst.cli import main
code = main(sys.argv[1:])
print("sent:", *sent)
sys.exit(code)
"""
HERE = {"TZ": "UTC", "LC_ALL": "C", "PYTHONHASHSEED": "1"}
ELSEWHERE = {"TZ": "Asia/Kathmandu", "LC_ALL": "de_DE.UTF-8", "PYTHONHASHSEED": "2"}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What was printed and found in two surroundings, both at once."""
    folder = tmp_path_factory.mktemp("rig")
    u = np.sin(0.003 * np.arange(300.0) ** 1.3)
    y = 2.0 * u + 0.4 * u**2 + 0.01 * np.random.default_rng(3).normal(size=u.size)
    times = pd.date_range("2024-03-10T01:30", periods=u.size, freq="10ms")  # clocks change at 2
    table = pd.DataFrame({"time": times.strftime("%Y-%m-%dT%H:%M:%S.%f"), "u": u, "y": y})
    table.to_csv(folder / "rig.csv", index=False)
    command = [sys.executable, "-c", WATCHED, "diagnose", str(folder / "rig.csv")]
    command += ["--drive", "u", "--response", "y", "--time", "time", "--model", "gain"]
    command += ["--effects", "offset,static_nonlinearity", "--jobs", "1", "--quiet"]
    running = []
    for k, surroundings in enumerate((HERE, ELSEWHERE)):
        outputs = {"--json": folder / f"{k}.json"}
        if surroundings is HERE:
            outputs |= {"--report": folder / "report.html", "--save": folder / "model.skops"}
        own = [*command, *(str(word) for pair in outputs.items() for word in pair)]
        process = subprocess.Popen(
            own, env=os.environ | surroundings, stdout=subprocess.PIPE, text=True
        )
        running.append((process, outputs["--json"]))
    said = [process.communicate()[0] for process, _ in running]
    assert [process.returncode for process, _ in running] == [0, 0]
    return said, [json.loads(path.read_text(encoding="utf-8")) for _, path in running]


def test_nothing_is_sent(results):
    for said in results[0]:
        assert said.splitlines()[-1] == "sent:"


def test_zone_language_and_order_of_hashes_change_nothing(results):
    one, other = results[1]
    assert one["effects"] == ["static_nonlinearity"]
    for result in (one, other):
        for name in ("command", "seconds"):
            result.pop(name)
    assert one == other
