"""Models in series."""

import dataclasses

from ..operators import SeriesOperator
from ..optimize import identify
from ._composition import Composition

__all__ = ["Cascade"]

_TOLERANCE = 1e-4  # of the fits along the way


class Cascade(Composition):
    """Models in series, identified jointly: the output of one is the input of the next.

    The static gain and the intercept belong to one step, the hysteresis where there is one; all
    others have unit gain, since only the product can be known. Steps are added one by one, each
    from its own data-driven starting values, then everything is refined together.

    Parameters
    ----------
    steps : list of (str, estimator)
        Names and models, in the order of the signal.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; that of the steps is not used.
    dt : float, default=1.0
        Sampling interval in s of data without a time index; that of the steps is not used.

    Attributes
    ----------
    operator_ : SeriesOperator
    operators_ : dict of str to Operator
        The identified operator of each step.
    params_, params_std_ : dict
        Parameters, named ``step__parameter``, and their standard errors.

    Raises
    ------
    TypeError
        If a step is not a parametric model.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Cascade
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> from skhyst.linear import FirstOrderLag
    >>> from skhyst.operators import FirstOrderLagOperator
    >>> drive = np.sin(np.linspace(0, 40, 2000)) * np.linspace(0, 1, 2000)
    >>> y, _ = FirstOrderLagOperator(0.05).run(drive, 0.01)
    >>> steps = [("hysteresis", PrandtlIshlinskii(5)), ("lag", FirstOrderLag())]
    >>> model = Cascade(steps, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> round(model.operators_["lag"].time_constant, 4)
    0.05
    """

    def _compose(self, names, stages):
        return SeriesOperator(tuple(names), tuple(stages)).normalized()

    def _identify(self, data):
        self._check_steps()
        state, fixed = self._free_run_state(), self._fixed()
        names, stages, evaluations, result = [], [], 0, None
        for name, step in self.steps:
            names.append(name)
            if result is None:
                records = data
            else:
                records = [
                    dataclasses.replace(
                        record,
                        u=result.operator.run(
                            record.u, record.dt, result.operator.init(record.u[0], state)
                        )[0],
                    )
                    for record in data
                ]
            candidates = [
                self._compose(names, [*stages, operator])
                for operator, disturbances in step._starts(records)
                if not disturbances
            ]
            if not candidates:
                raise ValueError(
                    f"The step '{name}' of Cascade is a disturbance: it stands beside a model, in "
                    "a Sum."
                )
            result = identify(
                [(operator, ()) for operator in candidates],
                data,
                fixed=fixed,
                initial_state=state,
                tolerance=1e-8 if len(names) == len(self.steps) else _TOLERANCE,
            )
            stages = list(result.operator.stages)
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)
