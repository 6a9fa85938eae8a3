"""What the search asks of operators: of leaves, of trees, and of an operator that says nothing."""

import pytest

from skhyst.diagnosis._traits import (
    characteristics,
    lag_rates,
    n_ringing,
    presliding_displacement,
)
from skhyst.hysteresis import DahlOperator
from skhyst.linear import FirstOrderLagOperator, GainOperator, SecondOrderModeOperator
from skhyst.operators import FrozenOperator, Series, SumOperator

LAG, MODE = FirstOrderLagOperator(0.1), SecondOrderModeOperator(5.0, 0.1)
DAHL = DahlOperator(presliding_displacement=0.3, coulomb_force=1.0)


def test_an_operator_that_says_nothing():
    gain = GainOperator(2.0)
    assert (n_ringing(gain), lag_rates(gain), characteristics(gain, None)) == (0, [], {})
    assert presliding_displacement(gain) is None


@pytest.mark.parametrize("kind", [Series, SumOperator])
def test_a_tree_has_what_its_leaves_have(kind):
    inner = FrozenOperator(kind(("mode", "dahl"), (MODE, DAHL)))
    whole = kind(("lag", "inner"), (LAG, inner))
    assert lag_rates(whole) == [10.0]
    assert n_ringing(whole) == 1
    assert presliding_displacement(whole) == 0.3
    assert characteristics(whole, None) == {}
    assert characteristics(FrozenOperator(LAG), None).keys() == {"corner frequency"}
