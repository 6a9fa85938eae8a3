"""What a round of the search may claim."""

from dataclasses import replace

import numpy as np
import pytest

from skhyst.diagnosis._contest import Contestant
from skhyst.diagnosis._noise import Judgement
from skhyst.diagnosis._rounds import Rounds, _have_changed_places
from skhyst.diagnosis._structure import Structure
from skhyst.linear import KelvinVoigt, KelvinVoigtOperator, SecondOrderMode, SecondOrderModeOperator
from skhyst.optimize import RecordData

MODE = SecondOrderModeOperator(30.0, 0.05)


def contestant(effect, structure):
    return Contestant(effect, structure, 1.0, 4, np.empty(0))


@pytest.mark.parametrize(("damping", "changed"), [(0.05, False), (0.5, False), (3.0, True)])
def test_a_mode_in_the_place_of_another_is_no_further_mode(damping, changed):
    """An overdamped mode creeps: what was added is then the declared mode, not the missing one."""
    declared = Structure(("mode",), (SecondOrderMode(),), (MODE,))
    base = contestant("", declared)
    bent = replace(declared, operators=(replace(MODE, damping_ratio=damping),))
    found = bent.insert("resonance", SecondOrderMode(), MODE)
    assert _have_changed_places(base, contestant("resonance", found)) == changed
    creeping = KelvinVoigtOperator(np.array([0.2]), np.array([1.0]))
    found = bent.insert("creep", KelvinVoigt(1), creeping)
    assert not _have_changed_places(base, contestant("creep", found))


def test_a_mode_behind_a_lag_is_a_further_mode():
    declared = Structure(("creep",), (KelvinVoigt(1),), (KelvinVoigtOperator([0.2], [1.0]),))
    found = declared.insert("resonance", SecondOrderMode(), MODE)
    assert not _have_changed_places(contestant("", declared), contestant("resonance", found))


@pytest.mark.parametrize(
    ("structure", "part", "claimed"),
    [(0.9, 0.1, True), (0.9, 0.4, True), (0.9, 0.6, False), (0.4, 0.1, False)],
)
def test_what_is_known_to_be_missing_needs_no_correction(structure, part, claimed):
    """An effect is claimed where it explains more than half of what is structure for the most."""
    rng = np.random.default_rng(0)
    n = 30
    segments = tuple((16 * i, 16 * i + 16) for i in range(n))
    record = RecordData(np.zeros(16 * n), np.zeros(16 * n), 1.0, segments=segments)
    squares = rng.uniform(0.8, 1.2, n)

    def tested(effect, squares):
        error = np.sqrt(squares.mean())
        cost = squares.sum()
        return replace(
            contestant(effect, None), cost=cost, squared_errors=squares, error=error, p_value=1.0
        )

    judgement = Judgement(True, 0.1, 0.0, structure, False)
    rounds = Rounds(
        [], [record], [], 0.01, 0.05, 3, None, 0.0, print, None, lambda c, records: judgement
    )
    base = tested("", squares)
    helps = tested("lag", part * squares * rng.uniform(0.8, 1.2, n))
    does_not = tested("offset", squares * rng.uniform(0.4, 1.6, n))
    found = rounds._evident(base, [does_not, helps])
    assert [c.effect for c, _ in found] == (["lag"] if claimed else [])
    for _, row in found:
        assert 0.0 < row["p_value"] < 0.01
    luck = np.where(np.arange(n) < 3, 1e-3, 1.1)  # a few stretches: less than half is explained
    assert rounds._evident(base, [tested("lag", luck * squares)]) == []
    heavy = np.where(np.arange(n) < 3, 100.0, 0.1)  # more than half, but it shows in three only
    better = np.where(np.arange(n) < 3, 0.1, rng.uniform(0.05, 0.15, n))
    assert rounds._evident(tested("", heavy), [tested("lag", better)]) == []
