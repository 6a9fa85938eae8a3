"""First-order stages that are nonlinear in themselves, and recordings that begin under way."""

import matplotlib
import numpy as np
import pytest

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import SecondOrderMode, TransferFunction
from skhyst.optimize import RecordData

matplotlib.use("Agg")
pytestmark = pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
SUBSTEPS = 20
NAMES = ["static_nonlinearity", "output_saturation", "offset"]


def tanks(u, w, power, ceiling, share):
    """Integrate two tanks by small steps, without skhyst."""
    (a, b), y = w, np.empty(len(u))
    fine = np.interp(np.arange(len(u) * SUBSTEPS) / SUBSTEPS, np.arange(len(u)), u)
    for k, q in enumerate(fine):
        if k % SUBSTEPS == 0:
            y[k // SUBSTEPS] = b
        out, over = a**power, 0.0
        a += (q - out) / (12.0 * SUBSTEPS)
        if a > ceiling:
            over, a = 12.0 * SUBSTEPS * (a - ceiling), ceiling
        b += (out + share * over - b**power) / (6.0 * SUBSTEPS)
    return y


def recording(power, ceiling=np.inf):
    rng = np.random.default_rng(4)
    n = 1500
    u = np.interp(np.arange(n), np.arange(0, n + 15, 15), rng.uniform(0.2, 1.8, n // 15 + 1))
    y = tanks(u, (0.4, 1.1), power, ceiling, 0.5)
    return u.reshape(-1, 1), 4.0 * y + 0.02 * rng.normal(size=n)


def search(X, y, declared=None, names=NAMES):
    declared = declared or TransferFunction(2, initial_state="estimate")
    return EffectSearchCV(declared, effects=names, cv=3, random_state=0).fit(X, y)


@pytest.mark.slow
def test_tanks_are_found():
    found, name = search(*recording(0.5, 0.9)), NAMES[1]
    assert found.effects_ == [name]
    assert found.error_after_ < 0.5 * found.error_before_
    evidence = found.evidence_[name]
    assert "power of the level" in evidence.statement
    assert found.best_estimator_.initial_drive_.shape == (1, 10)
    assert np.isfinite(found.predict(recording(0.5)[0])).all()


@pytest.fixture(scope="module")
def linear():
    return search(*recording(1.0))


def test_nothing_is_found_in_a_linear_chain(linear):
    assert linear.effects_ == []


@pytest.mark.slow
def test_nothing_is_found_in_a_linear_chain_of_two_equal_poles():
    model = SecondOrderMode(initial_state="estimate")
    assert search(*recording(1.0), declared=model).effects_ == []


def test_what_came_before_is_known_between_the_stages(linear):
    (X, y), found = recording(1.0), linear
    (record,) = found.declared_estimator_.records_
    before = found.declared_estimator_.initial_drive_
    path = np.interp(np.arange(-512, 0), -(2 ** np.arange(9, -1, -1)), before[0, ::-1])
    u = np.concatenate([path, X[record.rows, 0]])
    expected, _ = found.declared_estimator_.operator_.run(u, record.dt)
    records = [RecordData(X[:, 0], y, 1.0)]
    np.testing.assert_allclose(found._structure.respond(records)[0], expected[512:])


@pytest.mark.slow
def test_core_is_found_behind_its_hysteresis():
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=2500)) / 15
    plays, _ = PrandtlIshlinskiiOperator([0.0, 0.2, 0.5], [0.7, 0.4, 0.3]).run(u, 1.0)
    y = plays / (1 + np.abs(plays / 1.5)) + 0.004 * rng.normal(size=len(u))
    declared = PrandtlIshlinskii(thresholds=[0.0, 0.2, 0.5])
    found = search(u.reshape(-1, 1), y, declared, [*NAMES, "asymmetry"])
    (claim,) = found.history_.itertuples()
    assert "output_saturation" in {claim.effect, *claim.ambiguous_with}
