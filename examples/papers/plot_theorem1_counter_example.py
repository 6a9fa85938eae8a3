"""
Drive and gradient do not determine hysteresis: a counter-example
=================================================================

Theorem 1 of Ahmed and Yan, *IEEE Access*, 2021, says that the drive and its generalised gradient
determine the response of a hysteresis, so that a static network of the two can learn it. That is
true for one steady loop. Here are two loops for which it is false.
"""

# %%
# The drive reaches the same minor loop between 0.25 and 0.75 V from above and from below, always at
# the same rate. The plant is a sum of five plays, computed without skhyst.

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline, make_union

from skhyst.neural import SCNRegressor
from skhyst.preprocessing import GeneralizedInputGradient, PlayOperators

SPEED = 1 / 128  # V per sample


def path(corners):
    """Return straight lines from corner to corner."""
    parts = [
        a + np.sign(b - a) * SPEED * np.arange(1, round(abs(b - a) / SPEED) + 1)
        for a, b in pairwise(corners)
    ]
    return np.concatenate([corners[:1], *parts])


def play(u, r):
    """Return the output of one play operator."""
    state, out = 0.0, np.empty(len(u))
    for k, value in enumerate(u):
        state = max(value - r, min(value + r, state))
        out[k] = state
    return out


above = path([0.0, 1.5, 0.25, 0.75, 0.25, 0.75, 0.25])
below = path([0.25, -1.0, 0.75, 0.25, 0.75, 0.25])
u = np.concatenate([above, below[1:]])
weights = {0.0: 1.0, 0.1: 0.5, 0.2: 0.4, 0.4: 0.6, 0.7: 0.5}  # of the plays, by threshold in V
y = sum(w * play(u, r) for r, w in weights.items())
X = u.reshape(-1, 1)

# %%
# In the last descent of both loops drive and gradient are equal to the last bit, but the responses
# differ. Any static map of the two has an error of at least half the difference for one of them.

n = round(0.5 / SPEED)
first, second = slice(len(above) - n, len(above)), slice(len(u) - n, len(u))
features = GeneralizedInputGradient().fit_transform(X)
print("drive and gradient equal:", np.array_equal(features[first], features[second]))
gap = np.abs(y[first] - y[second]).max()
span = np.ptp(y)
print(f"responses differ by {gap:.3f} um, {100 * gap / span:.1f} % of the range")
print(f"so the error of any static map is at least {0.5 * gap:.3f} um")

# %%
# A network of drive and gradient cannot do better. Play operators as further inputs are states that
# remember from which side the loop was reached, and then even a linear map is exact.

gradient = GeneralizedInputGradient()
states = make_union(GeneralizedInputGradient(), PlayOperators(thresholds=list(weights)))
network = SCNRegressor(35, random_state=0)
models = {
    "network of drive and gradient": make_pipeline(gradient, network),
    "linear map with play states": make_pipeline(states, LinearRegression()),
}
predicted = {}
for name, model in models.items():
    predicted[name] = model.fit(X, y).predict(X)
    print(f"{name:30s} largest error {np.abs(predicted[name] - y).max():9.2e} um")

# %%

figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained", sharex=True)
axes[0].plot(u, y, color="0.8", label="whole record")
axes[1].axhline(0.5 * gap, color="0.6", ls=":")
axes[1].axhline(-0.5 * gap, color="0.6", ls=":", label="bound for any static map")
for part, label, color in ((first, "reached from above", "C0"), (second, "from below", "C3")):
    loop = slice(part.stop - 2 * n, part.stop)
    axes[0].plot(u[loop], y[loop], color=color, label=label)
    for style, (name, value) in zip(("-", "--"), predicted.items(), strict=True):
        axes[1].plot(u[part], (value - y)[part], style, color=color, label=f"{name}, {label}")
axes[0].set(xlabel="drive (V)", ylabel="response (µm)")
axes[0].legend()
axes[1].set(xlabel="drive (V)", ylabel="error in the last descents (µm)", ylim=(-0.5, 1.1))
axes[1].set(xlim=(0.0, 1.0))
axes[0].set(ylim=(-1.5, 3.0))
axes[1].legend(fontsize="small", loc="upper center")
plt.show()
