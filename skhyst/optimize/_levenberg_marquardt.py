"""Levenberg-Marquardt with a damping that changes by factors, as used by Ahmed and Yan (2021)."""

from dataclasses import dataclass

import numpy as np

from ._variable_projection import Method, restrict, variable_projection

_FULL_RUNS = 2  # starts that are followed to convergence
_TRIAL_EPOCHS = 3


@dataclass(frozen=True, kw_only=True)
class LevenbergMarquardt(Method):
    r"""Levenberg-Marquardt as neural networks are trained, with exact derivatives.

    .. math:: \Delta w = (J^\top J + \mu I)^{-1} J^\top e

    for all weights at once. An epoch ends with a step that reduces the error; the damping
    :math:`\mu` then falls, and rises after each step that does not. The weights are the parameters
    in units that give their columns of :math:`J` length one, so that :math:`\mu` has no unit.

    Weights that enter linearly start at their exact solution. Every start is followed for a few
    epochs, the best two to the end.

    Parameters
    ----------
    max_epochs : int, default=1000
        Budget of a run.
    goal : float, default=0.0
        Mean square of the error relative to that of the response at which the training ends.
    tolerance : float, default=1e-8
        Relative change of the sum of squares at which the training ends.
    mu : float, default=1e-3
        Damping of the first step.
    mu_decrease, mu_increase : float, default=0.1, 10.0
        Factors after a step that reduces the error and after one that does not.
    mu_max : float, default=1e10
        Damping at which the training ends: no step reduces the error.
    random_state : int or None, default=0
        Not used: nothing is random.

    See Also
    --------
    VariableProjection : Solves the linear parameters exactly in each step.

    References
    ----------
    Hagan and Menhaj, *IEEE Transactions on Neural Networks*, 1994. Ahmed and Yan, *IEEE Access*,
    2021, (27) and (42), where the sign of mu is wrong.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import SystemLevelHysteresis, SystemLevelOperator
    >>> drive = 50.0 - 50.0 * np.cos(np.linspace(0.0, 20.0, 500))
    >>> y, _ = SystemLevelOperator(0.1, 0.002, 0.03).run(drive, 1.0)
    >>> model = SystemLevelHysteresis(method="levenberg_marquardt").fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.decay:.4f}")
    0.0300
    """

    max_epochs: int = 1000
    goal: float = 0.0
    tolerance: float = 1e-8
    mu: float = 1e-3
    mu_decrease: float = 0.1
    mu_increase: float = 10.0
    mu_max: float = 1e10

    def solve(self, problems):
        for problem in problems:
            restrict(problem, self.bounds)
        starts, evaluations = problems, 0
        if len(starts) > _FULL_RUNS:
            trials = [self._train(p, min(_TRIAL_EPOCHS, self.max_epochs)) for p in problems]
            evaluations += sum(trial.n_evaluations for trial in trials)
            order = np.argsort([trial.cost for trial in trials], kind="stable")
            starts = [problems[i] for i in order[:_FULL_RUNS]]
        solutions = [(p, self._train(p, self.max_epochs, self._report)) for p in starts]
        evaluations += sum(solution.n_evaluations for _, solution in solutions)
        return *min(solutions, key=lambda pair: pair[1].cost), evaluations

    def _train(self, problem, max_epochs, callback=None):
        return variable_projection(
            problem,
            problem.x0,
            tolerance=self.tolerance,
            max_evaluations=np.inf,
            callback=callback,
            project=False,
            damping=_Factors(self.mu, self.mu_decrease, self.mu_increase, self.mu_max),
            max_steps=max_epochs,
            goal=self.goal,
        )


@dataclass
class _Factors:
    """Damping that changes by constant factors."""

    value: float
    decrease: float
    increase: float
    largest: float
    shorter = np.inf  # the length of a step is limited by the damping only

    def accepted(self, ratio):
        self.value = max(self.value * self.decrease, np.finfo(float).tiny)

    def refused(self):
        self.value *= self.increase
