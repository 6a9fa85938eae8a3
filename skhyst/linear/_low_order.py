"""First-order lag and second-order mode."""

from ..optimize import pole_starts, sections
from ._base import LinearModel, log_grid, time_span
from ._dynamics import FirstOrderLagOperator, SecondOrderModeOperator

__all__ = ["FirstOrderLag", "SecondOrderMode"]


class FirstOrderLag(LinearModel):
    r"""First-order low-pass, stepped exactly.

    .. math:: G(s) = \frac{g}{\tau s + 1}

    Parameters
    ----------
    fit_gain, fit_intercept : bool, default=True
        Whether the static gain (1 otherwise) and a constant response (0 otherwise) are fitted.
    hold : {"foh", "zoh"}, default="foh"
        Drive between samples: a straight line, or constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : FirstOrderLagOperator
        ``time_constant`` in s, ``gain`` in response units over drive units.
    params_, params_std_ : dict
        Parameters and their standard errors.

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

    def starting_values(self, records):
        dt, span = time_span(records)
        return [
            (FirstOrderLagOperator(float(tau), hold=self.hold), ())
            for tau in log_grid(0.3 * dt, 0.3 * span, 2)
        ]


class SecondOrderMode(LinearModel):
    r"""Second-order mode: mass, spring and damper.

    .. math:: G(s) = \frac{g}{s^2/\omega^2 + 2 \zeta s/\omega + 1}

    Parameters
    ----------
    fit_gain, fit_intercept : bool, default=True
        Whether the static gain (1 otherwise) and a constant response (0 otherwise) are fitted.
    hold : {"foh", "zoh"}, default="foh"
        Drive between samples: a straight line, or constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : SecondOrderModeOperator
        ``natural_frequency`` in rad/s, ``damping_ratio``, ``gain``.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderMode
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.05).run(drive, 0.01)
    >>> model = SecondOrderMode(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.natural_frequency:.2f} rad/s")
    60.00 rad/s
    """

    def starting_values(self, records):
        dt, span = time_span(records)
        starts = [
            SecondOrderModeOperator(float(w), zeta, hold=self.hold)
            for w in log_grid(6.0 / span, 1.5 / dt, 2)
            for zeta in (0.05, 0.5)
        ]
        for poles in pole_starts([(r.u, r.y, r.dt) for r in records], 2):
            _, frequencies, dampings = sections(poles)
            if len(frequencies):
                starts.append(
                    SecondOrderModeOperator(
                        float(frequencies[0]), float(dampings[0]), hold=self.hold
                    )
                )
        return [(start, ()) for start in starts]
