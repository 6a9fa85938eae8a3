"""Identification: the best of several starts, standard errors, what the data do not determine."""

import numpy as np
import pytest

from skhyst.disturbance import DriftOperator, OffsetOperator
from skhyst.hysteresis import FrictionStageOperator, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLagOperator,
    GainOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from skhyst.operators import Series, SumOperator
from skhyst.optimize import (
    DifferentialEvolution,
    RecordData,
    identify,
    pole_starts,
    sections,
)

DT = 0.02


def drive(seed, n):
    return np.cumsum(np.random.default_rng(seed).normal(size=n)) / 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "disturbances"),
    [
        (FirstOrderLagOperator(0.1, gain=2.0, intercept=0.5), ()),
        (SecondOrderModeOperator(30.0, 0.2, gain=2.0, intercept=0.5), ()),
        (FirstOrderLagOperator(0.1, gain=2.0), (DriftOperator(np.zeros(3), 0.5),)),
    ],
    ids=["lag", "mode", "lag with drift"],
)
def test_standard_errors_cover_at_their_rate(truth, disturbances):
    n_records = 6 if disturbances else 1
    n = 150 // n_records
    u = [drive(i, n) for i in range(n_records)]
    clean = [truth.run(part, DT)[0] for part in u]
    fixed = ("intercept",) if disturbances else ()
    rng, hits, count = np.random.default_rng(5), {}, 160
    for _ in range(count):
        records = [
            RecordData(a, b + 0.2 * rng.normal(size=n), DT) for a, b in zip(u, clean, strict=True)
        ]
        result = identify([(truth, disturbances)], records, fixed=fixed)
        for name, value in result.params.items():
            true = getattr(truth, name)
            inside = abs(value - true) < 1.96 * result.params_std[name]
            hits[name] = hits.get(name, 0) + inside
    assert set(hits) == {name for name, _ in truth.entries()} - set(fixed)
    for name, hit in hits.items():
        assert 0.90 <= hit / count <= 0.99, name


def test_standard_errors_of_a_straight_line():
    """Against the textbook formula, disturbances counted among the unknowns."""
    rng = np.random.default_rng(0)
    records = [RecordData(rng.normal(size=8), rng.normal(size=8), 1.0) for _ in range(3)]
    plays = PrandtlIshlinskiiOperator(np.zeros(1), np.zeros(1), non_negative=False)
    result = identify(
        [(plays, (OffsetOperator(np.zeros(1)),))], records, fixed=("drive_offset", "intercept")
    )
    u = np.concatenate([r.u - r.u.mean() for r in records])
    y = np.concatenate([r.y - r.y.mean() for r in records])
    slope = u @ y / (u @ u)
    variance = np.sum((y - slope * u) ** 2) / (24 - 4)
    assert result.params["weights[0]"] == pytest.approx(slope)
    assert result.params_std["weights[0]"] == pytest.approx(np.sqrt(variance / (u @ u)))
    np.testing.assert_allclose(
        result.record_coefficients[:, 0], [np.mean(r.y - slope * r.u) for r in records]
    )


def test_covariance_is_that_of_the_tangents_in_the_parameters_own_units():
    rng, u = np.random.default_rng(0), drive(0, 200)
    truth = SecondOrderModeOperator(30.0, 0.2, gain=2.0, intercept=0.5)
    y = truth.run(u, DT)[0] + 0.1 * rng.normal(size=len(u))
    result = identify([truth], [RecordData(u, y, DT)])
    model, tangents = result.operator.sensitivities(u, np.empty((len(u), 0)), DT)
    variance = np.sum((y - model) ** 2) / (len(u) - 4)
    expected = variance * np.linalg.inv(tangents.T @ tangents)
    np.testing.assert_allclose(result.covariance, expected, rtol=1e-5, atol=1e-12)
    std = list(result.params_std.values())
    np.testing.assert_allclose(std, np.sqrt(np.diag(expected)), rtol=1e-5)


@pytest.mark.parametrize("free", [{"time_constant"}, set()])
def test_fixed_entries_are_held(free):
    truth = FirstOrderLagOperator(0.1, gain=2.0, intercept=0.5)
    u = drive(0, 300)
    record = RecordData(u, truth.run(u, DT)[0], DT)
    start = FirstOrderLagOperator(0.3, gain=1.7, intercept=0.1)
    result = identify([start], [record], fixed={"gain", "intercept", "time_constant"} - free)
    assert (result.operator.gain, result.operator.intercept) == (1.7, 0.1)
    assert set(result.params) == free
    assert result.undetermined == ()
    error = result.operator.run(u, DT)[0] - record.y
    assert result.error == pytest.approx(np.sqrt(np.mean(error**2)))


METHODS = ["variable_projection", DifferentialEvolution(population=8, max_iterations=5)]


@pytest.mark.parametrize("method", METHODS)
def test_outputs_have_each_records_own_disturbance(method):
    lag, records = FirstOrderLagOperator(0.1, gain=2.0), []
    for i, offset in enumerate([1.0, -3.0]):
        u = drive(i, 200)
        records.append(RecordData(u, lag.run(u, DT)[0] + offset, DT))
    start = FirstOrderLagOperator(0.3), (OffsetOperator(np.zeros(1)),)
    result = identify([start], records, fixed=("intercept",), method=method)
    np.testing.assert_allclose(result.record_coefficients[:, 0], [1.0, -3.0], atol=1e-6)
    np.testing.assert_allclose(result.disturbances[0].coefficients, [-1.0], atol=1e-6)
    for record, y in zip(records, result.outputs(records), strict=True):
        np.testing.assert_allclose(y, record.y, atol=1e-5)


# ------------------------------------------------------------------------------- not determined


PLAYS = PrandtlIshlinskiiOperator(np.array([0.0, 0.5]), np.ones(2))
TWICE = SumOperator(("a", "b"), (FirstOrderLagOperator(0.1, 0.5),) * 2)
PROMPT = SumOperator(("plays", "creep"), (PLAYS, KelvinVoigtOperator([0.2], [0.3])))
UNDETERMINED = {
    "constant drive": (
        FirstOrderLagOperator(0.1),
        np.ones(100),
        {"time_constant", "gain", "intercept"},
    ),
    "threshold beyond the drive": (
        PrandtlIshlinskiiOperator(np.array([0.0, 0.1, 5.0]), np.ones(3)),
        np.sin(np.arange(200) / 9),
        {"weights[2]"},
    ),
    "twice the same": (
        TWICE,
        drive(0, 200),
        {"a__time_constant", "a__gain", "b__time_constant", "b__gain"},
    ),
    "two prompt gains": (
        PROMPT,
        drive(0, 200),
        {"plays__weights[0]", "creep__gain", "creep__compliances[0]"},
    ),
    "nothing": (
        Series(("plays", "lag"), (PLAYS, FirstOrderLagOperator(0.1))),
        drive(0, 400),
        set(),
    ),
}


@pytest.mark.parametrize("case", UNDETERMINED)
def test_undetermined_parameters_are_named(case):
    operator, u, names = UNDETERMINED[case]
    y, _ = operator.run(u, DT)
    y = y + 0.01 * np.random.default_rng(0).normal(size=len(u))
    fixed = {name for name, _ in operator.entries() if name.endswith("drive_offset")}
    result = identify([(operator, ())], [RecordData(u, y, DT)], fixed=fixed)
    inside = {name for name, std in result.params_std.items() if not np.isnan(std)}
    assert set(result.undetermined) == names & inside
    if names:
        assert names & inside
    else:
        assert inside == set(result.params)
        assert result.condition_number < 1e8
    for name, std in result.params_std.items():
        assert np.isinf(std) == (name in result.undetermined) or np.isnan(std)


# ---------------------------------------------------------------------------------------- starts


@pytest.mark.parametrize(
    "operator",
    [
        SecondOrderModeOperator(40.0, 0.05),
        SecondOrderModeOperator(10.0, 2.0),
        FirstOrderLagOperator(0.2),
        TransferFunctionOperator(np.array([0.3]), np.array([30.0]), np.array([0.1]), np.empty(0)),
    ],
    ids=["mode", "overdamped", "lag", "lag and mode"],
)
def test_pole_starts_hold_the_poles(operator):
    rng, records = np.random.default_rng(0), []
    for _ in range(2):
        u = rng.normal(size=1000)
        records.append((u, operator.run(u, DT)[0] + 1e-3 * rng.normal(size=1000), DT))
    truth = np.sort_complex(operator.poles())
    candidates = pole_starts(records, len(truth))
    errors = [np.abs(np.sort_complex(p) / truth - 1).max() for p in candidates]
    assert min(errors) < 0.05
    assert all((poles.real < 0).all() for poles in candidates)


def test_sections_keep_the_poles():
    poles = np.array([-1 + 5j, -1 - 5j, -2.0, -3.0, -0.5])
    tau, w, zeta = sections(poles)
    operator = TransferFunctionOperator(tau, w, zeta, np.empty(0))
    np.testing.assert_allclose(np.sort_complex(operator.poles()), np.sort_complex(poles), rtol=1e-9)
    np.testing.assert_allclose(tau, [2.0])  # the slowest real pole is the one left over


def test_what_is_lost_in_squares_is_not_determined():
    """Its own error would overflow."""
    rng = np.random.default_rng(0)
    record = RecordData(
        1e-150 * rng.standard_normal(200), 1.0 + 0.1 * rng.standard_normal(200), 1.0
    )
    result = identify([GainOperator(1.0)], [record])
    assert result.undetermined == ("gain",)
    assert result.params_std["intercept"] == pytest.approx(0.1 / np.sqrt(200), rel=0.2)


PLAYS = PrandtlIshlinskiiOperator(np.array([0.0, 0.5, 3.0]), np.array([1.0, 1.0, 1.4]))


def test_what_no_sample_shows_is_zero_wherever_the_fit_has_started():
    """No drive of this size moves the third play."""
    u = np.sin(np.arange(300) / 20.0)
    result = identify([PLAYS], [RecordData(u, 2.0 * u, DT)])
    np.testing.assert_allclose(result.operator.weights, [2.0, 0.0, 0.0], atol=1e-9)
    assert "weights[2]" in result.undetermined


@pytest.mark.parametrize("start", [(1.0, 0.0), (1.4, -7.0), (-20.0, 300.0)])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_what_cannot_be_told_apart_is_shared_in_equal_parts(start, scale):
    """At a drive that does not move, gain and intercept have half of the response each."""
    records = [RecordData(np.full(50, 2.0 * scale), np.full(50, 6.0), DT)]
    result = identify([GainOperator(start[0] / scale, start[1])], records)
    assert result.operator.gain * scale == pytest.approx(1.5, rel=1e-6)
    assert result.operator.intercept == pytest.approx(3.0, rel=1e-6)
    assert set(result.undetermined) == {"gain", "intercept"}


@pytest.mark.parametrize("start", [(0.0, 0.0), (5.0, 0.0), (0.0, 9.0)])
def test_equal_plays_share_their_weight_within_its_bounds(start):
    u = drive(0, 200)
    twice = PrandtlIshlinskiiOperator(np.array([0.5, 0.5]), np.array(start))
    y = 2.0 * PrandtlIshlinskiiOperator(np.array([0.5]), np.array([1.0])).run(u, DT)[0]
    result = identify([twice], [RecordData(u, y, DT)])
    np.testing.assert_allclose(result.operator.weights, [1.0, 1.0], rtol=1e-6)


def test_a_start_without_finite_derivatives_has_an_infinite_error():
    """A motion of 1e7 rad/s, in 64 substeps of 2 ms: its output is finite."""
    stage = FrictionStageOperator(1.6e7, 0.0035, 12.4, 1.0, 1.8e6, 0.98, n_substeps=64)
    u = 40.0 * np.sin(0.02 * np.arange(1500))
    result = identify([stage], [RecordData(u, u, 2e-3)])
    assert np.isfinite(stage.run(u, 2e-3)[0]).all()
    assert result.error == np.inf
