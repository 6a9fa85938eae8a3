"""Identification of the Jiles-Atherton model, from simulated and from measured loops."""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.io import loadmat

from skhyst.hysteresis import JilesAtherton, JilesAthertonOperator

MU0 = 4e-7 * np.pi
LOOPS = Path(__file__).parents[3] / "shared" / "data" / "bh_loops"


def magnetisation(fields, ms, a, k, alpha, c):
    """Integrate the textbook equation (M in A/m) through the fields, branch by branch."""

    def slope(h, m, direction):
        x = (h + alpha * m[0]) / a
        if abs(x) < 1e-3:
            curve, steep = ms * x / 3.0, ms / (3.0 * a)
        else:
            curve = ms * (1.0 / np.tanh(x) - 1.0 / x)
            steep = ms / a * (1.0 / x**2 - 1.0 / np.sinh(x) ** 2)
        gap = curve - m[0]
        loss = gap / (k * direction - alpha * gap) if gap * direction > 0.0 else 0.0
        return [(loss + c * steep) / (1.0 - c * alpha * steep)]

    found, m, last, start = np.empty(fields.size), 0.0, 0.0, 0
    turns = np.flatnonzero(np.diff(fields)[1:] * np.diff(fields)[:-1] < 0.0) + 1
    for turn in [*turns, fields.size - 1]:
        branch = fields[start : turn + 1]
        if branch[-1] != last:
            solution = solve_ivp(
                slope,
                (last, branch[-1]),
                [m],
                t_eval=branch,
                args=(np.sign(branch[-1] - last),),
                rtol=1e-9,
                atol=1e-9 * ms,
                max_step=2.0 * k,
            )
            m = solution.y[0, -1]
        found[start : turn + 1] = solution.y[0]
        last, start = branch[-1], turn + 1
    return found


def plant(seed, n=1200):
    """Loops of three amplitudes; return field, clean and noisy response, noise and parameters."""
    rng = np.random.default_rng(seed)
    a = 10.0 ** rng.uniform(-5, 5)
    k = a * 10.0 ** rng.uniform(-0.3, 0.4)
    coupling, c = rng.uniform(0.2, 0.75), rng.uniform(0.05, 0.4)
    ms = a * 10.0 ** rng.uniform(1.5, 2.0)
    scale = 10.0 ** rng.uniform(-6, 6)
    time = 3.0 * np.arange(n) / n
    fields = 8.0 * (a + k) * np.sin(2 * np.pi * time) * np.array([0.2, 0.5, 1.0])[time.astype(int)]
    clean = scale * (magnetisation(fields, ms, a, k, 3.0 * a * coupling / ms, c) + fields)
    truth = {
        "saturation": scale * ms,
        "shape": a,
        "pinning": k,
        "coupling": coupling,
        "reversibility": c,
        "gain": scale,
        "intercept": scale * ms * rng.uniform(-0.2, 0.2),
    }
    clean += truth["intercept"]
    noise = 0.005 * clean.std()
    return fields, clean, clean + noise * rng.normal(size=n), noise, truth


def test_recovery_and_standard_errors():
    covered, excess = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(30):
            u, clean, y, noise, truth = plant(seed)
            model = JilesAtherton().fit(u[:, None], y)
            rms = np.sqrt(noise**2 + np.mean((model.predict(u[:, None]) - clean) ** 2))
            excess.append(rms / noise)
            covered += [
                abs(model.params_[name] - value) < 1.96 * model.params_std_[name]
                for name, value in truth.items()
            ]
    assert max(excess) < 1.02
    assert 0.90 <= np.mean(covered) <= 0.99


def test_exact_recovery_with_a_known_gain():
    u, clean, _, _, truth = plant(0)
    model = JilesAtherton(truth["gain"]).fit(u[:, None], clean)
    assert "gain" not in model.params_
    assert model.operator_.gain == truth["gain"]
    for name in ("saturation", "shape", "pinning", "coupling"):
        assert model.params_[name] == pytest.approx(truth[name], rel=2e-3)


def test_steps_become_shorter_where_the_model_needs_it():
    """A wide soft tail and a narrow loop: the coercive field alone does not set the step."""
    truth = JilesAthertonOperator(1.0, 1.0, 4.0, 0.93, 0.1, max_step=0.01)
    u = 60.0 * np.sin(2 * np.pi * np.arange(1500) / 500) * np.linspace(0.1, 1.0, 1500)
    y, _ = truth.run(u, 1.0)
    model = JilesAtherton().fit(u[:, None], y)
    length = min(model.operator_.shape, model.operator_.pinning * (1 - model.operator_.coupling))
    assert model.operator_.max_step <= 0.2 * length
    assert model.fit_error_ < 2e-3


def test_units():
    u, _, y, _, _ = plant(3)
    reference = JilesAtherton().fit(u[:, None], y)
    other = JilesAtherton().fit(1e-9 * u[:, None], 1e7 * y)
    expected = 1e7 * reference.predict(u[:, None])
    np.testing.assert_allclose(
        other.predict(1e-9 * u[:, None]), expected, rtol=0, atol=1e-4 * np.ptp(expected)
    )


def test_drive_that_rests():
    model = JilesAtherton(fit_intercept=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(np.zeros((20, 1)), np.arange(20.0))
    assert np.isfinite(model.predict(np.ones((5, 1)))).all()


def test_wrong_gain():
    with pytest.raises(ValueError, match="The 'gain' parameter of JilesAtherton"):
        JilesAtherton("other").fit(np.ones((5, 1)), np.ones(5))


# -------------------------------------------------------------------------------- measured loops


def measured(folder, name):
    if not LOOPS.is_dir():
        pytest.skip("the recordings are not beside the project")
    fields = loadmat(LOOPS / folder / f"H_{name}.mat")["HmeasT"]
    return fields, loadmat(LOOPS / folder / f"B_{name}.mat")["BmeasT"]


def twice(fields, flux, columns):
    """Stack loops, each run through twice: the first turn leads in."""
    n = 2 * len(fields)
    index = pd.MultiIndex.from_product([columns, np.arange(n)], names=["record", "time"])
    drive = np.concatenate([np.tile(fields[:, i], 2) for i in columns])
    return (
        pd.DataFrame({"H": drive}, index),
        pd.Series(np.concatenate([np.tile(flux[:, i], 2) for i in columns]), index),
    )


@pytest.mark.parametrize(
    ("folder", "name", "held_out", "limit"),
    [
        ("1_isotropic", "MnZn_ferrite", 2, 0.015),
        ("1_isotropic", "MnZn_ferrite", 3, 0.025),
        ("10_APPA", "M130_27s", 2, 0.05),
    ],
)
def test_measured_loops_of_an_amplitude_not_seen(folder, name, held_out, limit):
    """Root mean square error over range, smaller and larger amplitudes being known."""
    fields, flux = measured(folder, name)
    seen = [i for i in range(fields.shape[1]) if i != held_out]
    model = JilesAtherton().fit(*twice(fields, flux, seen))
    X, y = twice(fields, flux, [held_out])
    error = (model.predict(X) - y)[len(fields) :]
    assert np.sqrt(np.mean(error**2)) < limit * np.ptp(y)
