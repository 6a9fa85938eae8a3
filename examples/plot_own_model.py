r"""
Write a model of your own
=========================

An operator implements the law and its derivatives, an estimator the starting values. Records,
fitting, cascades and the search follow from these. This example is a derivative action, :math:`y =
u + \tau \dot u`.
"""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from skhyst.base import ParametricModel
from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.operators import Operator, check_operator, parameter


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
        carried = du + self.time_constant * np.diff(du, axis=0, prepend=before) / dt
        return u + self.time_constant * slope, np.column_stack([carried, slope])


class Derivative(ParametricModel):
    operator_class = DerivativeOperator

    def starting_values(self, records):
        return [DerivativeOperator(0.0)]


# %%
# `check_operator` raises an error that names a wrong derivative. Then the model can be used like
# any other.
dt, rng = 1e-3, np.random.default_rng(0)
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
