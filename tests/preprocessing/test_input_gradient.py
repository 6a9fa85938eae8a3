import numpy as np
import pytest

from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.preprocessing import GeneralizedInputGradient


def features(drive, *args, **options):
    drive = np.asarray(drive, dtype=float).reshape(-1, 1)
    return GeneralizedInputGradient(*args, **options).fit_transform(drive)


@pytest.mark.parametrize("method", ["backward", "forward"])
def test_rate_of_a_ramp(method):
    Z = features(3.0 * np.arange(9), method, dt=0.5)
    np.testing.assert_array_equal(Z[1:, 1], 6.0)


@pytest.mark.parametrize("method", ["backward", "forward"])
def test_rate_before_a_turning_point_is_kept_there(method):
    # Equation (4): at the peak, sample 2, and at the valley, sample 4.
    Z = features([0.0, 1.0, 3.0, 2.0, 1.5, 5.0], method)
    assert Z[2, 1] == 2.0
    assert Z[4, 1] == -0.5


def test_methods_differ_by_one_sample_between_turning_points():
    u = np.array([0.0, 1.0, 3.0, 7.0, 6.0, 4.0, 1.0])
    backward, forward = features(u)[:, 1], features(u, "forward")[:, 1]
    np.testing.assert_array_equal(backward, [0, 1, 2, 4, -1, -2, -3])
    np.testing.assert_array_equal(forward, [1, 2, 4, 4, -2, -3, -3])


def test_error_is_of_first_order():
    errors = []
    for n_samples in (100, 200, 400):
        t = np.linspace(0.0, 1.0, n_samples)
        rate = features(np.sin(t), dt=t[1])[1:, 1]
        errors.append(np.abs(rate - np.cos(t[1:])).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 2.0, atol=0.1)


def test_last_extreme_is_where_the_branch_started():
    u = [1.0, 2.0, 2.0, 0.5, -1.0, -1.0, 3.0, 3.0, 4.0]
    Z = features(u, turning_points=True)
    np.testing.assert_array_equal(Z[:, 2], [0, 0, 0, 2, 2, 2, -1, -1, -1])
    np.testing.assert_array_equal(Z[:, 3], Z[:, 0] - Z[:, 2])


def test_first_loading_ends_where_the_drive_falls_back():
    np.testing.assert_array_equal(features([2.0, 1.0, 3.0], turning_points=True)[:, 2], [0, 2, 1])
    np.testing.assert_array_equal(features([0.0, 0.0, -1.0], turning_points=True)[:, 2], [0, 0, 0])


def test_drive_that_rests():
    np.testing.assert_array_equal(
        features([2.0, 2.0, 2.0], turning_points=True), [[2, 0, 0, 2]] * 3
    )


def test_direction_is_that_of_the_last_move():
    u = [1.0, 1.0, 2.0, 2.0, 1.5, 1.5, 1.6]
    Z = features(u, include_drive=False, include_rate=False, direction=True, dt=1e-9)
    np.testing.assert_array_equal(Z[:, 0], [0, 0, 1, 1, -1, -1, 1])


def test_last_extremes_are_those_of_a_plain_loop():
    u = np.round(np.cumsum(np.random.default_rng(0).standard_normal(200)), 1)
    found = [0.0] * 3
    moving, before, expected = 0.0, 0.0, []
    for value in u:
        if (value - before) * moving < 0.0:
            found = [before, *found[:2]]
        moving = np.sign(value - before) or moving
        before = value
        expected.append([found[0], value - found[0], found[1], found[2]])
    Z = features(u, include_drive=False, include_rate=False, turning_points=3)
    np.testing.assert_array_equal(Z, expected)


def test_names_and_nothing_chosen():
    transformer = GeneralizedInputGradient(direction=True, turning_points=2).fit(np.ones((3, 1)))
    names = ["", "_gradient", "_direction", "_last_extreme", "_distance", "_extreme2"]
    assert list(transformer.get_feature_names_out(["u"])) == ["u" + name for name in names]
    with pytest.raises(ValueError, match="must be true"):
        features([0.0, 1.0], include_drive=False, include_rate=False)


def test_drive_and_rate_are_not_the_whole_memory():
    # Two histories end with the same drive and rate and differ in the response; the last
    # extreme tells them apart.
    operator = PrandtlIshlinskiiOperator([0.0, 1.0, 2.0], [1.0, 1.0, 1.0])
    ends, rows = [], []
    for start in (-6.0, -1.0):
        u = np.array([0.0, 6.0, start, 0.0, 1.0])
        ends.append(operator.run(u, 1.0)[0][-1])
        rows.append(features(u, turning_points=True)[-1])
    np.testing.assert_array_equal(rows[0][:2], rows[1][:2])
    assert abs(ends[0] - ends[1]) > 0.5
    assert rows[0][2] != rows[1][2]
