"""A resonance that moves with the amplitude, behind dynamics that are held or not known."""

import numpy as np
import pytest
from scipy.signal import lsim

from skhyst.diagnosis import EffectSearchCV
from skhyst.linear import Gain
from skhyst.records import stack_records

DT, N = 0.002, 400
SMALL, LARGE = (60.0, 0.05), (55.0, 0.08)  # natural frequency in rad/s, damping ratio


def recording(moves):
    """Return what the dynamics of small amplitudes predict, and the response, of six records."""
    rng = np.random.default_rng(9000)
    time, found = DT * np.arange(N), []
    for number in range(6):
        amplitude = 1.0 + number % 2
        w = rng.uniform(5.0, 150.0, 12)
        u = np.sin(np.outer(time, w) + rng.uniform(0.0, 6.0, 12)).sum(axis=1)
        u *= 2.0 * amplitude / np.ptp(u)
        y = u
        if moves and amplitude > 1.0:
            below, above = ([1.0 / w**2, 2.0 * d / w, 1.0] for w, d in (SMALL, LARGE))
            y = u[0] + lsim((below, above), u - u[0], time)[1]
        found.append((u, y + 0.01 * rng.standard_normal(N)))
    return stack_records(found, dt=DT)


@pytest.mark.slow
def test_moved_mode_is_found_with_its_frequencies():
    search = EffectSearchCV(
        Gain(), effects=["amplitude_dependence", "resonance", "lag"], random_state=0
    ).fit(*recording(True))
    assert search.effects_ == ["amplitude_dependence"]
    assert search.error_after_ < 0.0105
    numbers = search.evidence_["amplitude_dependence"].numbers
    for label, (w, _) in (("small", SMALL), ("large", LARGE)):
        frequency = numbers[f"mode 1, {label} amplitude"][0]
        assert frequency == pytest.approx(w / (2.0 * np.pi), rel=0.01)
    assert search.verdict_ == "noise"


@pytest.mark.slow
def test_nothing_moves_where_nothing_does():
    search = EffectSearchCV(Gain(), effects=["amplitude_dependence"], random_state=0)
    assert search.fit(*recording(False)).effects_ == []
