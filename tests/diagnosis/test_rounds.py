"""What a round of the search may claim."""

from dataclasses import replace

import numpy as np
import pytest

from skhyst.diagnosis._contest import Contestant
from skhyst.diagnosis._rounds import _have_changed_places
from skhyst.diagnosis._structure import Structure
from skhyst.linear import KelvinVoigt, SecondOrderMode
from skhyst.operators import KelvinVoigtOperator, SecondOrderModeOperator

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
