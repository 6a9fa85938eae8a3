"""First-order lag, ``1 / (time_constant s + 1)``."""

from dataclasses import dataclass, replace

import numpy as np

from ..operators import parameter
from ._linear import LinearModel, LinearOperator, log_grid, time_span


@dataclass(frozen=True)
class FirstOrderLagOperator(LinearOperator):
    """First-order low-pass ``1 / (time_constant s + 1)``.

    Parameters
    ----------
    time_constant : float
        In s.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> FirstOrderLagOperator(1.0).run([0.0, 1.0, 1.0], dt=1.0)[0].round(3).tolist()
    [0.0, 0.368, 0.767]
    """

    time_constant: float = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    n_poles = (1, 0)

    def with_poles(self, rates, pairs):
        return replace(self, time_constant=float(1.0 / rates[0]))

    def lag_rates(self):
        return [1.0 / self.time_constant]

    def characteristics(self, seen):
        return {"corner frequency": (0.5 / (np.pi * self.time_constant), "Hz")}

    def _matrices(self, p):
        rate = 1.0 / p[0]
        return np.array([[-rate]]), np.array([rate]), np.array([p[1]]), 0.0 * p[0]


class FirstOrderLag(LinearModel):
    r"""First-order low-pass, stepped exactly.

    .. math:: G(s) = \frac{g}{\tau s + 1}

    Attributes
    ----------
    operator_ : FirstOrderLagOperator
        ``time_constant`` in s, ``gain`` in response units over drive units.

    See Also
    --------
    SecondOrderMode : Two poles, which may ring.
    TransferFunction : Any number of poles and zeros.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import FirstOrderLag
    >>> time = np.arange(200) * 0.01
    >>> X, y = np.ones((200, 1)), 2.0 * (1.0 - np.exp(-time / 0.1))
    >>> model = FirstOrderLag(dt=0.01, initial_state="zero", fit_intercept=False, hold="zoh")
    >>> print(f"{model.fit(X, y).operator_.time_constant:.3f} s")
    0.100 s
    """

    operator_class = FirstOrderLagOperator

    def starting_values(self, records):
        dt, span = time_span(records)
        return [
            FirstOrderLagOperator(float(tau), hold=self.hold)
            for tau in log_grid(0.3 * dt, 0.3 * span, 2)
        ]
