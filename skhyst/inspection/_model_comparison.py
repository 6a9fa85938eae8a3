"""Which model to declare: models of one mechanism each, compared on held-out data.

A model is fitted to all samples, and from there once more for every fold, to the training samples
of the fold; the whole record is simulated, so that the history of held-out samples is known.

Of models that predict equally well the one with the fewest parameters is taken: one whose error is
larger by less than 5 %, or its mean square by less than one standard error of the difference over
the folds (the one standard error rule of Breiman et al., *Classification and Regression Trees*,
1984, section 3.4.3, for paired differences). Models that join two mechanisms show how far such a
model can come. They are not taken: what a second mechanism adds is what a search tests. But where
one of them has an error three times smaller than any model of one mechanism, one of its parts is
taken, since from another model the search would have to find both.

A device may be in motion at the first sample, as tanks that are half full. A start that is
estimated from the record is compared where it helps the mode, which is near to most of them.
"""

import math
import warnings
from collections import deque
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Self

import numpy as np
import pandas as pd
from sklearn.base import clone

from .._documentation import documented_like
from .._progress import watched
from .._validation import read_data, refuse_no_experiment, refuse_still
from ..base import ParametricModel, identified, refine, scored_where
from ..compose import Cascade
from ..fluid import TankChain
from ..hysteresis import (
    CoulombFriction,
    Dahl,
    FreeMass,
    FrictionStage,
    PrandtlIshlinskii,
)
from ..linear import DynamicStiffness, FirstOrderLag, Gain, SecondOrderMode, TransferFunction
from ..model_selection import segment_folds
from ..optimize import VariableProjection
from ..records import fill_lost_rows
from ._base import Display
from ._drawing import COLORS, INK, MUTED, new_axes, plain, tidy

FAR = 3.0
"""Ratio of errors by which another model is so much better that it should be declared."""

_MATTERS = 1.05  # as min_improvement of a search: a smaller gain is not worth more parameters
_NEAR = VariableProjection(tolerance=1e-4, max_evaluations=10)  # a fold begins near its solution
_PLAYS, _LAG, _MODE = PrandtlIshlinskii(), FirstOrderLag(), SecondOrderMode()
_FRICTION = FrictionStage(stribeck=False)
_SINGLE = {  # the name for --model: the model, its description
    "gain": (Gain(), "straight line"),
    "first_order_lag": (_LAG, "lag"),
    "prandtl_ishlinskii": (_PLAYS, "hysteresis of plays, at any rate"),
    "second_order_mode": (_MODE, "mass, spring and damper: force to motion"),
    "free_mass": (FreeMass(), "mass without a spring: force to motion"),
    "dynamic_stiffness": (DynamicStiffness(), "mass, spring and damper: motion to force"),
    "coulomb_friction": (CoulombFriction(), "friction: motion to force"),
    "dahl": (Dahl(), "spring with friction: motion to force"),
    "tank_chain": (TankChain(), "tanks: flow to level"),
    "transfer_function(n_poles=3)": (TransferFunction(n_poles=3), "linear, of order 3"),
}


def _begun(initial_state, how):
    """Return what a device whose past acts for long is compared as from another start."""
    names = "first_order_lag", "second_order_mode", "tank_chain", "transfer_function(n_poles=3)"
    start, found = f"initial_state={initial_state!r}", {}
    for name in names:
        model, about = _SINGLE[name]
        own = f"{name[:-1]}, {start})" if name[-1] == ")" else f"{name}({start})"
        found[own] = clone(model).set_params(initial_state=initial_state), f"{about}, {how}"
    return found


_FROM_ZERO = _begun("zero", "from zero")
_IN_MOTION = _begun("estimate", "from any start")
_MODE_IN_MOTION = "second_order_mode(initial_state='estimate')"
_JOINED = {
    "prandtl_ishlinskii+first_order_lag": (
        Cascade([("prandtl_ishlinskii", _PLAYS), ("first_order_lag", _LAG)]),
        "hysteresis, then a lag",
    ),
    "prandtl_ishlinskii+second_order_mode": (
        Cascade([("prandtl_ishlinskii", _PLAYS), ("second_order_mode", _MODE)]),
        "hysteresis, then a mode",
    ),
    "friction_stage(stribeck=False)": (_FRICTION, "mass, spring and damper with friction"),
    "free_mass(friction=True)": (FreeMass(friction=True), "mass with friction, without a spring"),
}
_PARTS = {  # parts of the joined models that may be declared
    "prandtl_ishlinskii+first_order_lag": ("prandtl_ishlinskii", "first_order_lag"),
    "prandtl_ishlinskii+second_order_mode": ("prandtl_ishlinskii", "second_order_mode"),
    "friction_stage(stribeck=False)": ("second_order_mode",),
    "free_mass(friction=True)": ("free_mass",),
}


def compare_models(
    X, y, models=None, *, cv=5, max_samples=5000, verbose=0, on_progress=None
) -> "ModelComparisonDisplay":
    """Compare models on held-out samples, and return which one to declare.

    Parameters
    ----------
    X : DataFrame or array-like of shape (n_samples, n_inputs)
        Column 0 is the drive; the index carries records and time.
    y : array-like of shape (n_samples,)
        Response.
    models : dict of str to ParametricModel, default=None
        Models by name. None: a straight line, a lag, hysteresis, an oscillating and a free mass,
        the forces that go with a motion, tanks and a linear model, by the names that ``skhyst
        diagnose --model`` takes, and four that join two of these mechanisms; where the drive of a
        record does not begin near zero, the lag, the mode, the tanks and the linear model from
        zero, too; where the mode predicts better from a start that is estimated, all of them from
        such a start, which is that of the whole record.
    cv : int, default=5
        Folds of contiguous blocks, as in :func:`skhyst.model_selection.segment_folds`.
    max_samples : int or None, default=5000
        Number of samples in the comparison: of longer data, the first part of each record. None:
        all.
    verbose : int, default=0
        Above 0, progress on standard error: a bar with the time left on a terminal, else lines.
    on_progress : callable or None, default=None
        Called with a :class:`~skhyst.diagnosis.Progress` before each model. An exception in it ends
        the comparison.

    Returns
    -------
    ModelComparisonDisplay
        Not drawn; its ``plot`` draws it. A model whose fit fails has no error. The model to
        declare has the fewest parameters among those whose error is at most 5 % larger than the
        least, or whose mean squared error is, by at most one standard error over the folds.

    Raises
    ------
    RecordError
        If the samples are not evenly spaced in time, drive or response is constant, the response is
        a column of X, the drive is the time, or no model can be fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.inspection import compare_models
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
    >>> drive = np.random.default_rng(0).normal(size=400)
    >>> y, _ = FirstOrderLagOperator(2.0).run(drive, 1.0)
    >>> models = {"line": Gain(), "lag": FirstOrderLag()}
    >>> compare_models(drive[:, None], y, models).taken
    'lag'
    """
    known = (_SINGLE | _JOINED) if models is None else {n: (m, "") for n, m in models.items()}
    wrong = next((m for m, _ in known.values() if not isinstance(m, ParametricModel)), None)
    if wrong is not None or not known:
        raise ValueError(
            "The 'models' parameter of compare_models must be a dict of name to parametric model "
            f"of skhyst. Got {models!r} instead."
        )
    X, y, read = fill_lost_rows(X, y)
    slices, columns, response = read_data(Gain(), X, y, reset=True)
    refuse_still(columns[:, 0])
    refuse_no_experiment(columns, response, slices)
    if models is None and _begins_driven(columns[:, 0], slices):
        known = _SINGLE | _FROM_ZERO | _JOINED
    n = len(response) if max_samples is None else max_samples
    rows = np.concatenate(
        [np.arange(s.rows.start, s.rows.start + _part(s, n / len(response))) for s in slices]
    )
    X, y = (v.iloc[rows] if hasattr(v, "iloc") else np.asarray(v)[rows] for v in (X, y))
    slices, _, response = read_data(Gain(), X, y, reset=True)
    read = np.ones(len(rows), dtype=bool) if read is None else read[rows]
    segments, folds = segment_folds(slices, cv, X, response)
    spans = [
        slice(s.rows.start + start, s.rows.start + stop)
        for s, own in zip(slices, segments, strict=True)
        for start, stop in own
    ]
    masks = [[_rows(spans, part, len(rows)) & read for part in fold] for fold in folds]
    score = partial(_scored, X=X, y=y, read=read, masks=masks)
    with watched("compare_models", verbose, on_progress) as report_progress:
        score = partial(_each_scored, score=score, report_progress=report_progress)
        found = score(known)
        if models is None:
            modes = [own.error for n, own in found.items() if n.startswith("second_order_mode")]
            others = dict(_IN_MOTION)
            moving = score({_MODE_IN_MOTION: others.pop(_MODE_IN_MOTION)})
            if _MATTERS * moving[_MODE_IN_MOTION].error < np.nanmin(modes):
                found |= moving | score(others)
            known = _SINGLE | _FROM_ZERO | _IN_MOTION | _JOINED
    table = pd.DataFrame.from_dict(
        {
            name: (about, name not in _JOINED or models is not None, own.error, own.n_parameters)
            for name, (_, about) in known.items()
            if (own := found.get(name))
        },
        orient="index",
        columns=["about", "single", "error", "n_parameters"],
    ).rename_axis("model")
    if table["error"].isna().all():
        raise next(own.failure for own in found.values())
    squares = {name: own.squares for name, own in found.items()}
    whole, taken, as_good = _taken(table, squares)
    own = {"whole": whole, "response_name": str(getattr(y, "name", None) or "response")}
    if as_good:
        own["difference"] = _difference(squares[taken], squares[as_good])
    return ModelComparisonDisplay(table, taken, as_good, float(np.ptp(response)), **own)


class _Score(NamedTuple):
    """How well a model predicts what is held out: NaN where its fit has failed."""

    error: float
    squares: list  # mean squared error of each fold
    n_parameters: int
    failure: Exception | None = None


def _each_scored(models, score, report_progress):
    """Return the scores by name.

    The last models take longest: both ends in turn have a mean time that holds for the rest.
    """
    names, found = deque(models), {}
    for done in range(len(models)):
        name = names.pop() if done % 2 else names.popleft()
        report_progress("", None, name, done, len(models))
        found[name] = score(models[name][0])
    report_progress("", None, "", len(models), len(models))
    return {name: found[name] for name in models}


def _scored(model, X, y, read, masks):
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of fits that are only compared
            count, e = _held_out(clone(model), X, y, read, masks)
    except (ValueError, ArithmeticError) as error:
        return _Score(np.nan, [np.nan] * len(masks), 0, error)
    scored = np.logical_or.reduce([test for _, test in masks])
    squares = [np.mean(np.square(e[test])) for _, test in masks]
    return _Score(float(np.sqrt(np.mean(np.square(e[scored])))), squares, count)


def _begins_driven(drive, slices):
    """Whether a record begins at a drive that is not a small part of the range."""
    first = [drive[s.rows.start] for s in slices]
    return np.max(np.abs(first)) > (_MATTERS - 1.0) * np.ptp(drive)


def _part(record, share):
    return record.n_samples if share >= 1.0 else max(int(share * record.n_samples), 2)


def _rows(spans, chosen, n):
    mask = np.zeros(n, dtype=bool)
    for i in np.flatnonzero(chosen):
        mask[spans[i]] = True
    return mask


def _held_out(model, X, y, read, masks):
    """Return the number of parameters, and the held-out residual of each sample (n_samples,).

    Samples that were not ``read`` (n_samples,) are not fitted. A start that is estimated is that of
    the whole record.
    """
    slices, array, response = read_data(model, X, y, reset=True)
    records = scored_where(model.record_data(slices, array, response), slices, read)
    whole, result = identified(model, records)  # from its starts, without the further ones of a fit
    whole, left = whole.finish(result, records), np.full(len(response), np.nan)
    if hasattr(whole, "initial_drive_"):
        starts = zip(records, whole.initial_drive_, strict=True)
        records = [replace(record, before=before) for record, before in starts]
    begin, state = [whole.tree(whole.operator_)], whole.free_run_state
    for train, test in masks:
        weighted = [
            replace(record, weights=train[s.rows].astype(float))
            for record, s in zip(records, slices, strict=True)
        ]
        own = refine(whole, begin, weighted, _NEAR, with_errors=False)
        left[test] = (response - np.concatenate(own.outputs(weighted, state)))[test]
    return len(whole.params_), left


def _taken(table, squares):
    """Return the joined model, or None; the model to declare, and one as good, or None."""
    table = table.sort_values("n_parameters", kind="stable")
    single, joined = (table.loc[table["single"] == own, "error"].dropna() for own in (True, False))
    if joined.size and FAR * joined.min() < single.min():
        whole, _ = _simplest(joined, squares)
        parts = single[single.index.isin(_PARTS[whole])]
        if parts.size:
            return whole, *_simplest(parts, squares)
    return None, *_simplest(single, squares)


def _simplest(errors, squares):
    """Return the simplest model that is as good as the best, and the best one if it is another.

    ``errors`` are a Series by the name of the model, that with the fewest parameters first.
    """
    best = errors.idxmin()
    for name in errors.index:
        more, scatter = _difference(squares[name], squares[best])
        if errors[name] <= _MATTERS * errors[best] or more <= scatter:
            return name, None if name == best else best


def _difference(squares, least):
    """Return the mean difference of the squared errors of folds, and its standard error.

    Both are relative to the mean of the second.
    """
    more = np.subtract(squares, least) / (np.mean(least) or 1.0)
    return float(np.mean(more)), float(np.std(more, ddof=1) / np.sqrt(len(more)))


class ModelComparisonDisplay(Display):
    """Held-out errors of models, and which one to declare.

    Made by :func:`compare_models`. All parameters are kept as attributes.

    Parameters
    ----------
    table : DataFrame
        One row per model, by its name: ``about``, its description; ``single``, whether it has one
        mechanism and so may be declared; ``error``, its held-out root mean square error in units of
        the response, NaN if its fit fails; ``n_parameters``.
    taken : str
        Name of the model to declare.
    as_good : str or None
        The model of least error, if it is another one and its error is not smaller beyond the
        scatter between folds.
    response_range : float
        Range of the response.
    whole : str or None, default=None
        The model of two mechanisms with ``taken`` as one part, if its error is three times smaller
        than that of any model of one mechanism.
    response_name : str, default="response"
        Name for the axis.
    difference : tuple of float or None, default=None
        By how much the mean squared error of ``taken`` in the folds is larger than that of
        ``as_good``, relative to the latter, and the standard error of this difference.

    Examples
    --------
    >>> import pandas as pd
    >>> from skhyst.inspection import ModelComparisonDisplay
    >>> table = pd.DataFrame({
    ...     "about": ["straight line", "a mode with friction"], "single": [True, False],
    ...     "error": [0.8, 0.1], "n_parameters": [2, 9]}, index=["gain", "friction_stage"])
    >>> ModelComparisonDisplay(table, "gain", None, 10.0).worse("gain")
    8.0
    """

    def __init__(
        self,
        table,
        taken,
        as_good,
        response_range,
        *,
        whole=None,
        response_name="response",
        difference=None,
    ):
        self.table = table
        self.taken = taken
        self.as_good = as_good
        self.response_range = response_range
        self.whole = whole
        self.response_name = response_name
        self.difference = difference

    @property
    def best(self) -> str:
        """Name of the model of least error."""
        return self.table["error"].idxmin()

    @property
    def reason(self) -> str:
        """Reason for the choice of this model, in a sentence or two."""
        table, taken = self.table, self.taken
        why = "it has the least held-out error"
        if self.as_good:
            few, many = table.loc[[taken, self.as_good], "n_parameters"]
            error, least = table.loc[[taken, self.as_good], "error"]
            why = (
                f"its error, {self._share(error)}, is not distinguished from that of "
                f"{self.as_good}, {self._share(least)}, and it has {few} parameters instead of "
                f"{many}"
            )
            if error > _MATTERS * least and self.difference:
                more, scatter = (100.0 * value for value in self.difference)
                why += f": the squared error is larger by {more:.0f} ± {scatter:.0f} % in the folds"
        elif self.whole:
            why += f" of the parts of {self.whole}"
        elif not table["single"].all():
            why += " of the models with one mechanism"
        if not self.worse(taken) > FAR:
            return f"{taken}: {why}."
        best = self.whole or self.best
        times = table.loc[taken, "error"] / table.loc[best, "error"]
        return (
            f"{taken}: {why}. {best} ({table.loc[best, 'about']}) has an error {times:.2g} times "
            "smaller: the search tests what it adds."
        )

    def worse(self, name) -> float:
        """Return the error of a model relative to the least error.

        Parameters
        ----------
        name : str
            Name of the model, as in ``table``.

        Returns
        -------
        float
        """
        error, least = self.table.loc[name, "error"], self.table["error"].min()
        return float(error / least) if error > least > 0.0 else math.inf if error > least else 1.0

    def lines(self) -> list[str]:
        """Return the table as lines of text, errors in per cent of the response's range.

        Returns
        -------
        list of str
        """
        width = max(map(len, self.table.index))
        head = f"{'':2s}{'model':{width}s}  {'error':>8s}  what it is"
        rows = [
            f"{'>' if name == self.taken else '':2s}{name:{width}s}  "
            f"{self._share(row.error):>8s}  {row.about}".rstrip()
            for name, row in zip(self.table.index, self.table.itertuples(), strict=True)
        ]
        return [head, *rows]

    def _share(self, error):
        return f"{100.0 * error / self.response_range:.3g} %" if error >= 0.0 else "failed"

    def __str__(self):
        return "\n".join([*self.lines(), self.reason])

    __repr__ = __str__

    @documented_like(Display.plot)
    def plot(self, ax=None) -> Self:
        """Draw the errors on a logarithmic axis, that of the model to declare in another colour."""
        table = self.table.dropna(subset="error").iloc[::-1]
        size = (7.0, 1.0 + 0.32 * len(table))
        axes = new_axes(ax, 1, 1, "ModelComparisonDisplay", size=size)[0, 0]
        share = 100.0 * table["error"] / self.response_range
        heights = np.arange(len(table))
        for height, name, value, single in zip(
            heights, table.index, share, table["single"], strict=True
        ):
            color = COLORS[0] if name == self.taken else COLORS[1] if single else MUTED
            axes.plot(value, height, "o", color=color, markerfacecolor=color if single else "none")
        axes.set_xscale("log")
        tidy(axes, x_label=f"held-out error of {self.response_name}, % of its range (RMS)")
        axes.set_yticks(heights, [plain(name) for name in table.index])
        for label in axes.get_yticklabels():
            chosen = label.get_text() == plain(self.taken)
            label.set(fontweight="bold" if chosen else "normal", color=INK)
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-0.6, len(table) - 0.4)
        self.ax_, self.figure_ = axes, axes.figure
        return self
