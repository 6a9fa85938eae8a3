"""What the newcomer is shown of files; `python tests/newcomer/newcomer.py` searches the others."""

import pytest
from newcomer import CASES, Outcome, inspected, run
from readings import READINGS

from skhyst.cli import main


@pytest.mark.parametrize("name", READINGS)
def test_a_newcomer_is_shown_the_truth(name, tmp_path, capsys):
    def inspect(*words):
        code = main(["inspect", *map(str, words)])
        return Outcome("".join(capsys.readouterr()), code, 0.0)

    fault, outcome = inspected(name, tmp_path, inspect)
    assert not fault, outcome.text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["milliseconds.csv", "twice.csv"])
def test_a_newcomer_finds_the_truth(name, tmp_path, capsys):
    def diagnose(path, *options):
        few = ["--effects", "hysteresis,resonance,output_saturation", "--jobs", "1", "--quiet"]
        code = main(["diagnose", str(path), *few, *options])
        return Outcome("".join(capsys.readouterr()), code, 0.0)

    fault, outcomes = run(name, tmp_path, diagnose)
    assert not fault, outcomes[-1].text


def test_every_trap_is_another():
    assert len(CASES) == len({case.write for case in CASES.values()})
    files = [*CASES.values(), *READINGS.values()]
    refused = sum(getattr(one, "refused", "") != "" for one in files)
    assert len(files) - refused - 1 >= 27  # of the searched ones, one has no response
    assert all(len(one.option) <= 2 for one in files)  # one option and its value
