r"""
Write a model of your own
=========================

The shortest way is a law of one state: a function that takes one step and returns its derivatives.
Records, fitting, standard errors, cascades, the inverse, C code, FMUs, observers and the search
follow from it. This example is a valve that opens faster than it closes,

.. math:: \dot x = (u - x) / \tau, \qquad \tau = \tau_\text{up} \text{ if } u > x
   \text{ else } \tau_\text{down}, \qquad y = g x .
"""

from dataclasses import dataclass
from math import exp
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from skhyst.base import ParametricModel
from skhyst.compose import Cascade
from skhyst.control import InverseCompensator, Observer
from skhyst.export import to_c
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.operators import OneStateOperator, Operator, check_operator, parameter


def valve(x, u0, u1, dt, values):
    """Return the new state and the output, and the derivatives of each."""
    up, down, gain = values
    opens = u1 > x
    tau = up if opens else down
    a = exp(-dt / tau)
    gap = (x - u1) * a
    x1 = u1 + gap
    by_tau = gap * dt / tau**2
    # by x, u0, u1, then by the parameters: the state depends on two of them, the output on three
    x1_by = (a, 0.0, 1.0 - a, by_tau if opens else 0.0, 0.0 if opens else by_tau)
    y_by = (gain * a, 0.0, gain * (1.0 - a), gain * x1_by[3], gain * x1_by[4], x1)
    return x1, gain * x1, x1_by, y_by


@dataclass(frozen=True)
class ValveOperator(OneStateOperator, step=valve):
    time_constant_up: float = parameter(log=True, lower=0.0, unit="s")
    time_constant_down: float = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(linear=True, gauge=1.0, default=1.0, unit="response/drive")
    moves_at_rest = True  # the state still moves while the drive rests

    def rest(self, u0):
        return u0, (1.0, 0.0, 0.0)  # and its derivatives by u0 and what the state depends on


class Valve(ParametricModel):
    operator_class = ValveOperator

    def starting_values(self, records):
        return [ValveOperator(tau, tau) for tau in (0.01, 0.1, 1.0)]


# %%
# `check_operator` raises an error that names a wrong derivative. Then the model can be used like
# any other.
dt, rng = 1e-2, np.random.default_rng(0)
plant = ValveOperator(0.05, 0.4, 2.0)
check_operator(plant, rng.normal(size=50), dt)
X = np.repeat(rng.uniform(0.0, 1.0, 40), 50)[:, None]
y = plant.run(X[:, 0], dt)[0] + 0.01 * rng.normal(size=2000)
model = Valve(dt=dt).fit(X, y)
for name, value in model.params_.items():
    print(f"{name} {value:.4f} +- {model.params_std_[name]:.4f}")
reference = 1.0 + 0.3 * np.sin(np.arange(400) * dt)
drive = InverseCompensator(model).fit(X, y).predict(reference[:, None])
print(f"misses a reference by {np.abs(model.predict(drive[:, None]) - reference).max():.1e}")
filtered = Observer(model).fit(X, y).filter(X, y)
print(f"the observer's estimate is within {np.std(filtered - plant.run(X[:, 0], dt)[0]):.4f}")
with TemporaryDirectory() as folder:
    print("C files:", *sorted(path.name for path in to_c(model, folder, name="valve")))

# %%
# More states
# -----------
# A law of any other kind gives the operator's run and its sensitivities itself: here a derivative
# action, :math:`y = u + \tau \dot u`.


@dataclass(frozen=True)
class DerivativeOperator(Operator):
    time_constant: float = parameter(linear=True, unit="s")
    signal_linear = True

    def init(self, u0, initial_state="rest"):
        return float(u0) if initial_state == "rest" else 0.0

    def run(self, u, dt, state=None):
        slope = np.diff(u, prepend=u[0] if state is None else state) / dt
        return u + self.time_constant * slope, float(u[-1])

    def sensitivities(self, u, du, dt, initial_state="rest"):
        slope = np.diff(u, prepend=self.init(u[0], initial_state)) / dt
        before = du[:1] if initial_state == "rest" else 0.0 * du[:1]
        propagated = du + self.time_constant * np.diff(du, axis=0, prepend=before) / dt
        return u + self.time_constant * slope, np.column_stack([propagated, slope])


class Derivative(ParametricModel):
    operator_class = DerivativeOperator

    def starting_values(self, records):
        return [DerivativeOperator(0.0)]


dt = 1e-3
check_operator(DerivativeOperator(0.004), rng.normal(size=50), dt)
time = dt * np.arange(4000)
X = np.sin(2 * np.pi * (0.5 * time + 1.5 * time**2))[:, None]
bent, _ = PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.5]).run(X[:, 0], dt)
y = DerivativeOperator(0.004).run(bent, dt)[0] + 0.003 * rng.normal(size=4000)
alone = PrandtlIshlinskii(10).fit(X, y)
model = Cascade([("plays", PrandtlIshlinskii(10)), ("derivative", Derivative())], dt=dt).fit(X, y)
print(f"time constant {model.params_['derivative__time_constant']:.5f} s, in the plant 0.004 s")
plt.plot(time, y - alone.predict(X), time, y - model.predict(X))
plt.legend(["hysteresis alone", "with the derivative"], title="residual over time (s)")
plt.show()
