"""
Close the loop: find the effect that the model lacks
====================================================

A plant with hysteresis and one more effect, a declared model with hysteresis only, and a search
that is given only the recording and the declared model.
"""

# %%
# The plant
# ---------
# It is simulated here and shares no code with the package: eighty plays, then a Kelvin-Voigt unit
# that relaxes with a time constant of half a second, integrated with twenty steps per sample. The
# sensor noise is 0.2 % of the range.

import matplotlib.pyplot as plt
import numpy as np

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.inspection import (
    EffectRankingDisplay,
    EvidenceDisplay,
    HysteresisLoopDisplay,
    ResidualDisplay,
)
from skhyst.records import stack_records

DT, N, FINE = 5e-3, 800, 20  # s, samples per record, steps per sample
TIME_CONSTANT, COMPLIANCE = 0.5, 0.15
rng = np.random.default_rng(2)
time = DT * np.arange(N)


def plant(drive):
    """Return the response (um) to a drive (V)."""
    thresholds = np.linspace(0.0, 50.0, 80)
    weights = 0.004 * np.exp(-thresholds / 25.0)
    fine = np.interp(np.arange(FINE * (N - 1) + 1) / FINE, np.arange(N), drive)
    plays, relaxed, response = np.zeros(80), None, np.empty(N)
    for k, u in enumerate(fine):
        plays = np.maximum(u - thresholds, np.minimum(u + thresholds, plays))
        prompt = 0.1 * u + weights @ plays
        relaxed = (
            prompt if relaxed is None else relaxed + DT / FINE / TIME_CONSTANT * (prompt - relaxed)
        )
        if k % FINE == 0:
            response[k // FINE] = prompt + COMPLIANCE * relaxed
    return response


def steps():
    """Return random levels, each held for a while, with smooth edges."""
    levels = np.repeat(rng.uniform(-50.0, 50.0, 10), N // 10)
    return np.convolve(np.r_[np.full(9, levels[0]), levels], np.full(10, 0.1), mode="valid")


def triangles():
    """Return ramps between random turning points."""
    turns = rng.uniform(20.0, 50.0, 12) * (-1.0) ** np.arange(12)
    return np.interp(np.arange(N), np.linspace(0, N - 1, 13), np.r_[0.0, turns])


drives = [steps(), triangles(), steps(), triangles()]
responses = [plant(drive) for drive in drives]
noise = 2e-3 * np.ptp(np.concatenate(responses))
noisy = [response + noise * rng.normal(size=N) for response in responses]
X, y = stack_records(list(zip(drives, noisy, strict=True)), dt=DT)
X, y = X.set_axis(["drive (V)"], axis=1), y.rename("response (µm)")

# %%
# The search
# ----------

search = EffectSearchCV(PrandtlIshlinskii(), random_state=0).fit(X, y)
print("missing:     ", search.effects_)
print("residual:    ", search.verdict_)
for name, error in (
    ("declared model", search.error_before_),
    ("with the effect", search.error_after_),
    ("noise floor", search.noise_floor_),
):
    print(f"{name:16s} {1e3 * error:6.1f} nm, {error / noise:5.2f} x the sensor noise")

# %%
# Every candidate of the first round: the fraction of the residual that it would explain, and the
# held-out error with it.

EffectRankingDisplay.from_search(search)
plt.show()

# %%
# The evidence for the claim.

evidence = search.evidence_[search.effects_[0]]
print(evidence.statement)
for name, (value, std, unit) in evidence.numbers.items():
    print(f"  {name}: {value:.4g}" + (f" +- {std:.2g}" if np.isfinite(std) else ""), unit)
EvidenceDisplay.from_search(search, effect=search.effects_[0])
plt.show()

# %%
# Before and after; each sample is predicted by a model that was not fitted to it.

HysteresisLoopDisplay.from_search(search, subtract_line=True)
ResidualDisplay.from_search(search)
plt.show()

# %%
# A model to keep
# ---------------

print(search.best_estimator_)
print(
    f"creep time constant {search.best_estimator_.params_['creep__time_constants[0]']:.3f} s, "
    f"in the plant {TIME_CONSTANT} s"
)
