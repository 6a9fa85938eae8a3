"""Force of a measured motion: mass, dashpot and spring."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from skhyst.exceptions import ConvergenceWarning
from skhyst.linear import DynamicStiffness, DynamicStiffnessOperator
from skhyst.records import stack_records

N, DT = 600, 1e-3
TIME = DT * np.arange(N)


def motion(seed, time=TIME):
    rng = np.random.default_rng(seed)
    frequencies = np.geomspace(5.0, 120.0, 6)
    waves = np.sin(np.outer(time, frequencies) + rng.uniform(0.0, 6.28, 6))
    return waves @ (rng.uniform(0.5, 1.5, 6) / frequencies)


def difference(x):
    return np.r_[0.0, np.diff(x)] / DT


@pytest.mark.parametrize(("length", "force"), [(1.0, 1.0), (1e9, 1e-3), (1e-9, 1e6)])
@pytest.mark.parametrize("drive", ["displacement", "velocity"])
def test_parameters_are_found_in_any_unit(drive, length, force):
    u = motion(0)
    columns = {"mass": difference(u), "damping": u}
    if drive == "displacement":
        columns = {"mass": difference(difference(u)), "damping": difference(u), "stiffness": u}
        columns["mass"][:2] = 0.0
    truth = dict(zip(columns, (2.0, 30.0, 400.0), strict=False))
    y = sum(truth[name] * column for name, column in columns.items()) - 7.0
    model = DynamicStiffness(drive=drive, dt=DT).fit(length * u[:, None], force * y)
    expected = {name: value * force / length for name, value in truth.items()}
    expected["intercept"] = -7.0 * force
    assert model.params_ == pytest.approx(expected, rel=1e-6, abs=0.0)


def test_standard_errors_cover_the_truth():
    truth = {"mass": 2.0, "damping": 30.0, "stiffness": 400.0, "intercept": 5.0}
    rng, hits = np.random.default_rng(0), []
    for seed in range(60):
        u = motion(seed)
        y, _ = DynamicStiffnessOperator(*truth.values()).run(u, DT)
        y += 0.05 * y.std() * rng.normal(size=N)
        model = DynamicStiffness(dt=DT).fit(u[:, None], y)
        for name, value in truth.items():
            hits.append(abs(model.params_[name] - value) <= 1.96 * model.params_std_[name])
    assert 0.90 <= np.mean(hits) <= 0.99


def test_it_undoes_a_mass_on_a_spring_to_first_order():
    """Displacements come from scipy; the lag of the differences shrinks with the interval."""
    m, d, k, errors = 2.0, 30.0, 4000.0, []
    for n in (1, 2):
        dt = DT / n
        time = dt * np.arange(n * N)
        force = 1e3 * motion(1, time)
        u = lsim(([1.0], [m, d, k]), force, time)[1]
        model = DynamicStiffness(dt=dt).fit(u[:, None], force)
        errors.append(np.sqrt(np.mean((model.predict(u[:, None]) - force)[2:] ** 2)))
        assert model.params_["mass"] == pytest.approx(m, rel=0.05)
        assert model.params_["stiffness"] == pytest.approx(k, rel=0.05)
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)


@settings(deadline=None, max_examples=15)
@given(n=st.integers(1, 12), seed=st.integers(0, 1000))
def test_slopes_are_those_of_straight_lines_through_the_last_samples(n, seed):
    u = np.random.default_rng(seed).normal(size=40)

    def slope(x, k):
        return np.polyfit(DT * np.arange(n + 1), x[k - n : k + 1], 1)[0]

    v, _ = DynamicStiffnessOperator(damping=1.0, smoothing=n).run(u, DT)
    a, _ = DynamicStiffnessOperator(mass=1.0, smoothing=n).run(u, DT)
    expected = np.array([slope(u, k) if k >= n else 0.0 for k in range(40)])
    np.testing.assert_allclose(v, expected, rtol=1e-9, atol=1e-9 / DT)
    expected = [slope(expected, k) if k >= 2 * n else 0.0 for k in range(40)]
    np.testing.assert_allclose(a, expected, rtol=1e-9, atol=1e-9 / DT**2)


def test_smoothing_helps_where_the_encoder_has_steps():
    time = DT * np.arange(4000)
    u = np.sin(6.0 * time) + 0.2 * np.sin(19.0 * time)
    a = -36.0 * np.sin(6.0 * time) - 72.2 * np.sin(19.0 * time)
    steps = 1e-3 * np.round(u / 1e-3)
    masses = [
        DynamicStiffness(smoothing=n, dt=DT).fit(steps[:, None], 2.0 * a).params_["mass"]
        for n in (1, 12)
    ]
    assert masses[0] < 1.0
    assert masses[1] == pytest.approx(2.0, rel=0.05)


def test_records_that_begin_in_motion_do_not_hurt():
    """A velocity out of a rest would be the largest acceleration of the record."""
    u = motion(3, DT * np.arange(2 * N))
    v = np.gradient(u, DT)
    y = 2.0 * np.gradient(v, DT) + 30.0 * v + 400.0 * u
    X, y = stack_records([(u[part], y[part]) for part in (slice(50, 500), slice(600, 1150))])
    X.index = X.index.set_levels(X.index.levels[1] * DT, level=1)
    model = DynamicStiffness().fit(X, y.set_axis(X.index))
    assert model.params_["mass"] == pytest.approx(2.0, rel=0.03)


def test_what_is_held_is_zero():
    u = motion(4)
    model = DynamicStiffness(False, fit_intercept=False, dt=DT).fit(u[:, None], 3.0 * u)
    assert set(model.params_) == {"damping", "stiffness"}
    assert model.operator_.mass == model.operator_.intercept == 0.0
    assert model.params_["stiffness"] == pytest.approx(3.0)


def test_drive_that_stands_still_determines_the_constant_alone():
    y = np.random.default_rng(0).normal(size=N)
    with (
        pytest.warns(ConvergenceWarning, match="damping, intercept, mass, stiffness"),
        pytest.warns(ConvergenceWarning, match="The drive does not move"),
    ):
        model = DynamicStiffness(dt=DT).fit(np.full((N, 1), 0.3), y + 5.0)
    np.testing.assert_allclose(model.predict(np.full((5, 1), 0.3)), y.mean() + 5.0)


def test_wrong_fields():
    with pytest.raises(ValueError, match="The 'drive' parameter of DynamicStiffnessOperator"):
        DynamicStiffnessOperator(drive="force")
    with pytest.raises(ValueError, match="The 'stiffness' parameter of DynamicStiffnessOperator"):
        DynamicStiffnessOperator(stiffness=1.0, drive="velocity")
