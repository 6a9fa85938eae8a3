"""
Write a model of your own
=========================

A model is an operator, which knows its law and its derivatives, and an estimator, which knows where
to start. Identification, records, cascades and the search come with that.
"""

# %%
# The operator
# ------------
# A derivative action, :math:`y = u + \tau \dot u`. It is a frozen dataclass: a field made with
# `parameter` is identified. `linearize` returns the output and its derivatives: the tangents of the
# input carried through, then a column for each parameter.

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from skhyst.base import ParametricModel
from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.operators import Operator, parameter


@dataclass(frozen=True)
class DerivativeOperator(Operator):
    """Derivative action by the backward difference."""

    time_constant: float = parameter(linear=True, unit="s")

    signal_linear = True  # the output is an affine function of the input signal
    rank = 30  # where it stands in a series: among the linear dynamics

    def init(self, u0, initial_state="rest"):
        return float(u0) if initial_state == "rest" else 0.0

    def run(self, u, dt, state=None):
        slope = np.diff(u, prepend=u[0] if state is None else state) / dt
        return u + self.time_constant * slope, float(u[-1])

    def linearize(self, u, du, dt, initial_state="rest"):
        at_rest = initial_state == "rest"
        slope = np.diff(u, prepend=self.init(u[0], initial_state)) / dt
        before = du[:1] if at_rest else np.zeros_like(du[:1])
        carried = du + self.time_constant * np.diff(du, axis=0, prepend=before) / dt
        return u + self.time_constant * slope, np.column_stack([carried, slope])


# %%
# The estimator
# -------------
# It gives starting values: a list of operators, each with the disturbances beside it (here none).
# What is linear is solved exactly, so one start is enough.


class Derivative(ParametricModel):
    """Derivative action, y = u + time_constant du/dt."""

    def __init__(self, *, initial_state="rest", dt=1.0):
        self.initial_state = initial_state
        self.dt = dt

    def starting_values(self, records):
        return [(DerivativeOperator(0.0), ())]


# %%
# Check the derivatives
# ---------------------
# Against finite differences; with a wrong `linearize` nothing else would work.

rng = np.random.default_rng(0)
dt = 1e-3  # s
u, du = rng.normal(size=(2, 50))
operator, step = DerivativeOperator(0.004), 1e-6
_, tangents = operator.linearize(u, du[:, None], dt)
along_u = (operator.run(u + step * du, dt)[0] - operator.run(u - step * du, dt)[0]) / (2 * step)
along_parameter = (
    DerivativeOperator(0.004 + step).run(u, dt)[0] - DerivativeOperator(0.004 - step).run(u, dt)[0]
) / (2 * step)
difference = tangents - np.column_stack([along_u, along_parameter])
print(
    f"largest error relative to the largest derivative: "
    f"{np.abs(difference).max() / np.abs(tangents).max():.1e}"
)

# %%
# Use it
# ------
# In a cascade it is fitted jointly with whatever stands before it.

time = dt * np.arange(4000)
drive = np.sin(2 * np.pi * (0.5 * time + 1.5 * time**2))
play, slope = 0.0, np.empty(4000)
bent = np.empty(4000)
for k, value in enumerate(drive):
    play = max(value - 0.3, min(value + 0.3, play))
    bent[k] = value + 0.5 * play
response = bent + 0.004 * np.diff(bent, prepend=bent[0]) / dt + 0.003 * rng.normal(size=4000)

X = drive[:, None]
model = Cascade([("hysteresis", PrandtlIshlinskii(10)), ("derivative", Derivative())], dt=dt)
model.fit(X, response)
value, std = (d["derivative__time_constant"] for d in (model.params_, model.params_std_))
print(f"time constant {1e3 * value:.3f} +- {1e3 * std:.3f} ms, in the plant 4 ms")

figure, axes = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
alone = PrandtlIshlinskii(10).fit(X, response)
axes.plot(time, response - alone.predict(X), label="hysteresis alone")
axes.plot(time, response - model.predict(X), label="with the derivative")
axes.set(xlabel="time (s)", ylabel="residual")
axes.legend()
plt.show()
