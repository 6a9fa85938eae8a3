"""Series and sums are operators again, with each freedom carried once."""

from dataclasses import replace

import numpy as np
import pytest

from skhyst.disturbance import OffsetOperator
from skhyst.hysteresis import BoucWenStageOperator, PrandtlIshlinskiiOperator
from skhyst.linear import (
    DelayOperator,
    FirstOrderLagOperator,
    GainOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
)
from skhyst.operators import (
    Factor,
    FrozenOperator,
    Series,
    SumOperator,
    add_disturbances,
    check_operator,
    split_disturbances,
)
from skhyst.static import DeadZoneOperator, SaturationOperator

DT = 0.01
U = 0.3 + np.cumsum(np.random.default_rng(0).normal(size=60)) / 4
EMPTY = np.empty((len(U), 0))
PLAYS = PrandtlIshlinskiiOperator(np.array([0.0, 0.2]), np.array([1.0, 0.5]), 0.1)
LAG = FirstOrderLagOperator(0.03, gain=1.4, intercept=-0.2)
MODE = SecondOrderModeOperator(90.0, 0.15, gain=0.8, intercept=0.1)
CREEP = KelvinVoigtOperator(np.array([0.2]), np.array([0.1]), 1.5, 0.3)
ZONES = DeadZoneOperator(np.array([0.4]), np.array([0.3]), np.array([1]))


def series(**stages):
    return Series(tuple(stages), tuple(stages.values()))


def parallel(**stages):
    return SumOperator(tuple(stages), tuple(stages.values()))


def named(operator, mark):
    return {name for name, spec in operator.entries() if getattr(spec, mark)}


def rank(operator):
    """Number of independent directions in which the free parameters move the output."""
    # the drive's offset and the intercept are one for a device whose memory is full
    free = [not (s.held or name.endswith("drive_offset")) for name, s in operator.entries()]
    tangents = operator.sensitivities(U, EMPTY, DT)[1][:, free]
    singular = np.linalg.svd(tangents / np.linalg.norm(tangents, axis=0), compute_uv=False)
    return int((singular > 1e-9 * singular[0]).sum()), sum(free)


def test_series_hands_the_output_on():
    middle, _ = PLAYS.run(U, DT)
    middle, _ = ZONES.run(middle, DT)
    expected, _ = LAG.run(middle, DT)
    chain = series(plays=PLAYS, zones=ZONES, lag=LAG)
    np.testing.assert_allclose(chain.run(U, DT)[0], expected, rtol=1e-13)
    zero = chain.run(U, DT, chain.init(U[0], "zero"))[0]
    middle = ZONES.run(PLAYS.run(U, DT, PLAYS.init(U[0], "zero"))[0], DT)[0]
    np.testing.assert_allclose(zero, LAG.run(middle, DT, LAG.init(0.0, "zero"))[0], rtol=1e-13)


def test_sum_adds():
    total = parallel(plays=PLAYS, lag=LAG, offset=OffsetOperator(np.array([0.4])))
    expected = PLAYS.run(U, DT)[0] + LAG.run(U, DT)[0] + 0.4
    np.testing.assert_allclose(total.run(U, DT)[0], expected, rtol=1e-13)
    np.testing.assert_array_equal(parallel().run(U, DT)[0], 0.0)


def test_linear_stages_commute():
    lag, creep = replace(LAG, intercept=0.0), replace(CREEP, intercept=0.0)
    one, _ = series(lag=lag, creep=creep).run(U, DT)
    other, _ = series(creep=creep, lag=lag).run(U, DT)
    np.testing.assert_allclose(one, other, rtol=1e-12)
    bent, _ = series(lag=lag, plays=PLAYS).run(U, DT)
    assert np.abs(bent - series(plays=PLAYS, lag=lag).run(U, DT)[0]).max() > 1e-2


MODES = parallel(first=MODE, second=SecondOrderModeOperator(40.0, 0.3, gain=0.3))
DELAY = DelayOperator(0.013)


@pytest.mark.parametrize(
    ("operator", "expected"),
    [
        # a hysteresis carries the gain and the intercept
        (
            series(plays=PLAYS, lag=LAG, mode=MODE),
            "lag__gain lag__intercept mode__gain mode__intercept",
        ),
        (series(lag=LAG, plays=PLAYS), "lag__gain lag__intercept"),
        (series(first=PLAYS, second=PLAYS), "second__intercept"),
        # else the last stage that can
        (series(lag=LAG, mode=MODE), "lag__gain lag__intercept"),
        (series(mode=MODE, delay=DELAY), ""),
        (series(delay=DELAY), ""),
        # a sum keeps every gain and one intercept, within a series it gives up one gain
        (parallel(lag=LAG, mode=MODE), "mode__intercept"),
        (parallel(plays=PLAYS, creep=CREEP), "creep__intercept"),
        (
            series(plays=PLAYS, modes=MODES),
            "modes__first__gain modes__first__intercept modes__second__intercept",
        ),
        (
            series(delay=DELAY, inner=series(plays=PLAYS, lag=LAG), mode=MODE),
            "inner__lag__gain inner__lag__intercept mode__gain mode__intercept",
        ),
    ],
)
def test_each_freedom_is_carried_once(operator, expected):
    assert named(operator, "held") == set(expected.split())


def test_linear_entries_of_a_series_are_those_of_one_stage():
    chain = series(plays=PLAYS, lag=LAG, mode=MODE)
    found = named(chain, "linear")
    assert found == {"plays__weights[0]", "plays__weights[1]", "plays__intercept"}
    # the lag's gain is held, so it is the motion that is solved exactly
    motion = BoucWenStageOperator(30.0, 0.1, 0.5, 1.0)
    chain = series(motion=motion, lag=LAG)
    assert named(chain, "linear") == {"motion__gain", "motion__intercept"}


@pytest.mark.parametrize(
    "operator",
    [
        series(plays=PLAYS, lag=LAG),
        series(plays=PLAYS, mode=MODE, creep=CREEP),
        series(lag=LAG, mode=MODE),
        series(plays=PLAYS, zones=ZONES, lag=LAG),
        series(plays=PLAYS, modes=MODES),
        parallel(plays=PLAYS, lag=LAG, mode=MODE),
        parallel(chain=series(plays=PLAYS, lag=LAG), mode=MODE),
        series(delay=DELAY, inner=series(plays=PLAYS, lag=LAG), mode=MODE),
    ],
    ids=lambda operator: "-".join(operator.names),
)
def test_free_parameters_are_independent(operator):
    """The gauge holds what must be held, and with it the data can determine all the rest."""
    found, free = rank(operator.normalized())
    assert found == free


def test_normalized_puts_held_values_at_their_gauge():
    chain = series(plays=PLAYS, lag=LAG, mode=MODE)
    plain = chain.normalized()
    assert [(s.gain, s.intercept) for s in plain.stages[1:]] == [(1.0, 0.0)] * 2
    assert chain.stages[1].gain == 1.4
    np.testing.assert_array_equal(plain.stages[0].pack(), PLAYS.pack())


def test_names_of_nested_entries():
    names = [name for name, _ in series(a=parallel(b=CREEP, c=LAG)).entries()]
    own = {"b": CREEP.entries(), "c": LAG.entries()}
    assert names == [f"a__{key}__{name}" for key, part in own.items() for name, _ in part]


def test_prompt_gain_of_two_branches_is_one_freedom():
    """The first play is a plain gain, and so is the prompt part of creep."""
    found, free = rank(parallel(plays=PLAYS, creep=CREEP).normalized())
    assert found == free - 1


def test_what_stands_beside_is_taken_off_again():
    offset = OffsetOperator(np.array([0.4]))
    assert split_disturbances(LAG) == (LAG, ())
    assert split_disturbances(add_disturbances(LAG, (offset,), ("offset",))) == (LAG, (offset,))
    assert split_disturbances(parallel(lag=LAG, offset=offset)) == (parallel(lag=LAG), (offset,))
    assert split_disturbances(offset) == (parallel(), (offset,))
    assert split_disturbances((MODE, (offset,))) == (MODE, (offset,))


@pytest.mark.parametrize("kind", [series, parallel])
def test_a_composition_declares_what_its_stages_do(kind):
    whole = kind(lag=LAG, inner=FrozenOperator(kind(mode=MODE, creep=CREEP)))
    assert whole.n_poles == (2, 1)
    assert not whole.memoryless
    assert not whole.is_disturbance
    assert kind(limit=SaturationOperator(upper=1.0), gain=GainOperator(2.0)).memoryless
    assert kind(mode=MODE).linear_mode() == MODE.linear_mode()
    assert whole.linear_mode() is None
    assert FrozenOperator(PLAYS).stage_order == PLAYS.stage_order
    stage = BoucWenStageOperator(90.0, 0.1, 0.5, 1.0, 0.0, 1.5)
    for motion in (FrozenOperator(stage), kind(stage=stage), kind(lag=LAG, stage=stage)):
        assert not motion.at_once
    assert whole.at_once
    for plays in (
        FrozenOperator(PLAYS),
        PLAYS * Factor(1),
        kind(limit=SaturationOperator(), p=PLAYS),
    ):
        assert plays.stage_order == PLAYS.stage_order == 10


class Wrong(FirstOrderLagOperator):
    """A lag that goes wrong in one place."""

    fault = None

    def run(self, u, dt, state=None):
        y, state = super().run(u, dt, state)
        return y, self.init(0.0) if self.fault == "state" else state

    def step(self, state, u, dt):
        state, y = super().step(state, u, dt)
        return state, y + 1e-3 * (self.fault == "step")

    def sensitivities(self, u, du, dt, initial_state="rest"):
        y, dy = super().sensitivities(u, du, dt, initial_state)
        dy[:, -3] *= 1.001 if self.fault == "derivative" else 1.0
        dy[:, 0] *= 1.001 if self.fault == "carried" else 1.0
        return y + (self.fault == "output"), dy[:, 1:] if self.fault == "shape" else dy


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("state", "A run cut at sample 30 and the whole"),
        ("step", "'step' from sample to sample"),
        ("derivative", "The derivative by time_constant"),
        ("carried", "The derivative by the input"),
        ("shape", "The tangents of 'sensitivities' must be"),
        ("output", "The output of 'sensitivities'"),
    ],
)
def test_the_check_of_an_operator_names_the_fault(fault, message):
    check_operator(Wrong(0.03, gain=1.4), U, DT)
    kind = type("Faulty", (Wrong,), {"fault": fault})
    with pytest.raises(AssertionError, match=message):
        check_operator(kind(0.03, gain=1.4), U, DT)
