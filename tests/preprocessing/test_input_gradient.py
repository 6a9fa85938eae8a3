import numpy as np
import pytest

from skhyst.preprocessing import GeneralizedInputGradient


def features(drive, *args, **options):
    drive = np.asarray(drive, dtype=float).reshape(-1, 1)
    return GeneralizedInputGradient(*args, **options).fit_transform(drive)


RAMP, BENT, TURNING = 3.0 * np.arange(5), [0, 1, 3, 7, 6, 4, 1], [0, 1, 3, 2, 1.5, 5]


@pytest.mark.parametrize(
    ("method", "drive", "rate"),
    [
        ("backward", RAMP, [0, 3, 3, 3, 3]),
        ("forward", RAMP, [3, 3, 3, 3, 3]),
        # between turning points the methods differ by one sample
        ("backward", BENT, [0, 1, 2, 4, -1, -2, -3]),
        ("forward", BENT, [1, 2, 4, 4, -2, -3, -3]),
        # equation (4): at the peak, sample 2, and at the valley, sample 4, the rate before is kept
        ("backward", TURNING, [0, 1, 2, -1, -0.5, 3.5]),
        ("forward", TURNING, [1, 2, 2, -0.5, -0.5, 3.5]),
    ],
)
@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_rate(method, drive, rate, dt):
    Z = features(drive, method, dt=dt)
    np.testing.assert_array_equal(Z, np.column_stack([drive, np.array(rate) / dt]))


def test_error_is_of_first_order():
    errors = []
    for n_samples in (100, 200, 400):
        t = np.linspace(0.0, 1.0, n_samples)
        rate = features(np.sin(t), dt=t[1])[1:, 1]
        errors.append(np.abs(rate - np.cos(t[1:])).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 2.0, atol=0.1)


@pytest.mark.parametrize(
    ("drive", "start"),
    [
        ([1, 2, 2, 0.5, -1, -1, 3, 3, 4], [0, 0, 0, 2, 2, 2, -1, -1, -1]),
        ([2, 1, 3], [0, 2, 1]),  # the first loading ends where the drive falls back
        ([0, 0, -1], [0, 0, 0]),
        ([2, 2, 2], [0, 0, 0]),
    ],
)
def test_last_extreme_is_where_the_branch_started(drive, start):
    Z = features(drive, include_rate=False, turning_points=True)
    np.testing.assert_array_equal(Z, np.transpose([drive, start, np.subtract(drive, start)]))


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
