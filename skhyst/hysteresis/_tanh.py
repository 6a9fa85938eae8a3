"""Hyperbolic tangent model of piezo actuators."""

import dataclasses

import numpy as np

from ..base import ParametricModel
from ..operators import TanhHysteresisOperator
from ..optimize import identify

__all__ = ["TanhHysteresis"]

_BENDS = np.geomspace(0.5, 500.0, 7)  # starts: gamma times the largest drive
_STEP = 20.0  # tanh of it is 1 to the last bit
_NEGLIGIBLE = 1e-9  # of the largest drive: such samples count as zero
_SIGNIFICANT = 3.84  # 95 % point of chi-squared, one degree of freedom
_ROUNDING = 1e-12  # of the response


class TanhHysteresis(ParametricModel):
    r"""Hyperbolic tangent model: a static curve and a term in the drive's rate.

    .. math:: z = k_0 u + \alpha \dot u + \beta \tanh(\gamma u) + c

    (equation (3) of the paper, plus a constant that is zero by default). The rate is the causal
    backward difference ``(u[k] - u[k-1]) / dt``. The model has no rate-independent memory: its
    loop closes only through ``alpha``, and its area vanishes at low frequency.

    Parameters
    ----------
    fit_intercept : bool, default=False
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest there, so that the rate begins at zero;
        the drive was zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : TanhHysteresisOperator
        ``k0`` in response/drive, ``alpha`` in response s/drive, ``beta`` in units of the response,
        ``gamma`` in 1/drive.
    params_, params_std_ : dict
        Parameters and their standard errors.
    identifiability_ : dict
        ``undetermined`` names ``gamma`` where the data do not reject (at 5 %) that the tangent is
        a step, which any large ``gamma`` gives.

    Notes
    -----
    With a drive that is never negative and a large ``gamma``, as in the paper, the tangent is 1
    wherever the drive is not zero: ``beta`` is an offset and ``gamma`` cannot be known. The fit
    then keeps a ``gamma`` that is a step for every sample, says so in ``identifiability_``, and
    warns.

    References
    ----------
    "Modeling and identification of nonlinear hysteresis behavior of piezoelectric actuators using
    a computationally efficient phenomenological model and modified cuckoo search algorithm",
    Smart Mater. Struct. 32 (2023) 015013, equation (3).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import TanhHysteresis
    >>> drive = 10.0 * np.sin(np.linspace(0.0, 20.0, 500))
    >>> y = 0.2 * drive + np.tanh(0.7 * drive)
    >>> model = TanhHysteresis().fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.gamma:.3f}")
    0.700
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_intercept": ["boolean"],
    }

    _rank = TanhHysteresisOperator.rank

    def __init__(
        self, fit_intercept=False, *, initial_state="rest", dt=1.0, method="variable_projection"
    ):
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        largest = _largest(records)
        return [(_start(bend / largest), ()) for bend in _BENDS]

    def _fixed(self):
        return frozenset() if self.fit_intercept else frozenset({"intercept"})

    def _identify(self, data):
        """Prefer a step to a bend where the data do not tell them apart.

        A large gamma is bounded from below only, which no standard error can say.
        """
        bend = super()._identify(data)
        magnitudes = np.abs(np.concatenate([record.u for record in data]))
        largest = _largest(data)
        smallest = magnitudes[magnitudes > _NEGLIGIBLE * largest].min(initial=largest)
        step = identify(
            [(_start(_STEP / smallest), ())],
            data,
            fixed=self._fixed(),
            initial_state=self._free_run_state(),
        )
        margin = _SIGNIFICANT / max(magnitudes.size - len(step.params), 1)
        power = np.mean(np.square(np.concatenate([record.y for record in data])))
        limit = bend.error**2 * (1.0 + margin) + _ROUNDING**2 * power
        return dataclasses.replace(
            step if step.error**2 <= limit else bend,
            n_evaluations=step.n_evaluations + bend.n_evaluations,
        )


def _largest(records):
    """Return the largest magnitude of the drive, 1 where it is zero throughout."""
    return max(float(np.abs(record.u).max()) for record in records) or 1.0


def _start(gamma):
    return TanhHysteresisOperator(0.0, 0.0, 1.0, float(gamma))
