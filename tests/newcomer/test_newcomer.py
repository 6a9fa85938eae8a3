"""Some of the newcomer's files; `python tests/newcomer/newcomer.py` searches all."""

import pytest
from newcomer import CASES, Outcome, run

from skhyst.cli import main

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["milliseconds.csv", "coded.csv", "twice.csv"])
def test_a_newcomer_finds_the_truth(name, tmp_path, capsys):
    def diagnose(path, *options):
        few = ["--effects", "hysteresis,resonance,output_saturation", "--jobs", "1", "--quiet"]
        code = main(["diagnose", str(path), *few, *options])
        return Outcome("".join(capsys.readouterr()), code, 0.0)

    fault, outcomes = run(name, tmp_path, diagnose)
    assert not fault, outcomes[-1].text


def test_every_trap_is_another():
    assert len(CASES) == len({case.write for case in CASES.values()}) >= 12
