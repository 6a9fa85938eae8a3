"""Models in series."""

import dataclasses

from ..operators import LinearOperator, SeriesOperator
from ..optimize import VariableProjection, identify
from ._composition import Composition

__all__ = ["Cascade"]

_ALONG_THE_WAY = VariableProjection(tolerance=1e-4)


class Cascade(Composition):
    """Models in series, identified jointly: the output of one is the input of the next.

    The static gain and the intercept belong to one step, the hysteresis where there is one; all
    others have unit gain, since only the product can be known. Steps are added one by one, each
    from its own data-driven starting values, then everything is refined together; several linear
    dynamics are added in both orders, and the better fit is kept.

    Parameters
    ----------
    steps : list of (str, estimator)
        Names and models, in the order of the signal.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; that of the steps is not used.
    dt : float, default=1.0
        Sampling interval in s of data without a time index; that of the steps is not used.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

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
        results = [self._add_steps(data, order) for order in self._orders()]
        best = min(results, key=lambda result: result.error)
        evaluations = sum(result.n_evaluations for result in results)
        return dataclasses.replace(best, n_evaluations=evaluations)

    def _orders(self):
        """Return the orders in which steps are added: as given, and dynamics from the last on.

        Dynamics that come first bend to make up for those that are missing still, and a local
        search may leave them there.
        """
        given = list(range(len(self.steps)))
        dynamics = [i for i in given if self.steps[i][1]._rank == LinearOperator.rank]
        other = given.copy()
        for place, i in zip(dynamics, reversed(dynamics), strict=True):
            other[place] = i
        return [given] if other == given else [given, other]

    def _add_steps(self, data, order):
        """Add the steps in an order, each behind those before it; refine all after each."""
        state, fixed = self._free_run_state(), self._fixed()
        stages, evaluations, result = {}, 0, None
        for i in order:
            name, step = self.steps[i]
            records = data
            for _, stage in sorted((j, stage) for j, stage in stages.items() if j < i):
                records = [
                    dataclasses.replace(
                        record, u=stage.run(record.u, record.dt, stage.init(record.u[0], state))[0]
                    )
                    for record in records
                ]
            places = sorted([*stages, i])
            names = [self.steps[j][0] for j in places]
            candidates = [
                self._compose(names, [(stages | {i: operator})[j] for j in places])
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
                method=self.method if len(names) == len(self.steps) else _ALONG_THE_WAY,
            )
            stages = dict(zip(places, result.operator.stages, strict=True))
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)
