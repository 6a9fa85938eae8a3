"""Mutants are drawn from what decides and computes, each in one place, with tests to notice it."""

from pathlib import Path

import faults
import mutants
import pytest

ROOT = Path(__file__).resolve().parents[2]

SOURCE = '''"""Words of 2 parts."""
LIMIT = 3


@jit
def loop(x, n=2):
    """Return 2 x."""
    for i in range(n):
        if x[i] <= -1.0 and not (x[i] == 0.5):
            break
    return min(x[0], 2e-12) + x[1] / 4


def words(x):
    if x.ü is None:
        raise ValueError(f"{x + 1} is " + "none")
    return zip(x, x, strict=True), [1]
'''


def written(edit):
    return SOURCE[edit.begin : edit.end] + " -> " + edit.faulty


def test_what_is_edited():
    compiled = [written(edit) for edit in mutants.edits(SOURCE, compiled=True)]
    assert compiled == [
        "<= -> >",
        "- -> +",
        "1.0 -> 2.0",
        "and -> or",
        "not -> ",
        "== -> !=",
        "0.5 -> 1.0",
        "break -> continue",
        "min -> max",
        "0 -> 1",
        "+ -> -",
        "1 -> 2",
        "/ -> *",
        "4 -> 8",
    ]
    everything = [written(edit) for edit in mutants.edits(SOURCE)]
    assert everything == [*compiled, "is -> is not"]
    for edit in mutants.edits(SOURCE):
        faulty = SOURCE[: edit.begin] + edit.faulty + SOURCE[edit.end :]
        compile(faulty, "source", "exec")


@pytest.fixture(scope="module")
def texts():
    return faults.sources(ROOT)


@pytest.mark.slow
def test_mutants_have_one_place(texts):
    drawn = mutants.draw_mutants(texts, 16)
    assert drawn == mutants.draw_mutants(texts, 16) != mutants.draw_mutants(texts, 16, seed=1)
    areas = [fault.area for fault in drawn]
    assert (areas.count("decisions"), areas.count("loops")) == (8, 8)
    for fault in drawn:
        (path,) = faults.places(fault, texts)
        compile(texts[path].replace(fault.original, fault.faulty), path, "exec")


def test_tests_are_named_for_files_that_are_there(texts):
    of_loops = [path for path in texts if mutants._loop_tests(path)]
    of_decisions = [path for path in texts if mutants._decision_tests(path)]
    assert len(of_loops) == len(mutants._KERNELS)
    assert len(of_decisions) == len(mutants._DECISIONS)
    assert all(mutants.edits(texts[path], compiled=True) for path in of_loops)
    named = [*mutants._DECISIONS.values(), *(more for more, _ in mutants._KERNELS.values())]
    absent = [
        name for name in " ".join(named).split() if not list(ROOT.glob(f"tests/**/{name}.py"))
    ]
    assert absent == []
