"""How a search treats the declared model: as a parametric model or as a black-box regressor.

A parametric model is split into its stages. Any other regressor is a black box f: its prediction p
replaces the drive, a gain is the first stage, and effects enter behind the gain or in parallel with
it. The p of each record is predicted by a fit to the other folds, so that no sample that is scored
was used by the fit. Since f has compensated for the missing effects, it is fitted again, to the
response minus the contribution of the effects, after an effect is added or removed. The two fits
alternate until the held-out error no longer falls (see ``compose.Backfitting``).
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_random_state

from .._validation import common_parameter
from ..base import ParametricModel, identified, read_data
from ..compose import Backfitting, Corrected, ScheduledParameters, Turn
from ..linear import Gain, TransferFunction
from ..model_selection import predicted_from
from ..operators import Operator
from ..optimize import with_input_history
from ._candidates import held_out, refitted
from ._constants import NOTICEABLE, TURNS
from ._tree import Tree, as_read


def declare(estimator, X, columns, y, slices, random_state, reference=None):
    """Return the unfitted Declared or BlackBox that represents an estimator in a search."""
    if getattr(estimator, "operator_class", Operator).is_disturbance:
        raise ValueError(
            "The 'estimator' parameter of EffectSearchCV must respond to a drive: declare a Sum of "
            f"such a model and the disturbance. Got {estimator!r} instead."
        )
    if _is_splittable(estimator):
        read_data(estimator, X, y, reset=True)
        if isinstance(estimator, TransferFunction) and not isinstance(estimator.inputs, str):
            # a stage of a composition does not know the names of the columns
            estimator.set_params(inputs=list(estimator.input_positions(columns.shape[1])))
        return Declared(estimator, columns, slices)
    return BlackBox(estimator, X, columns, y, slices, random_state, reference)


def _is_splittable(estimator):
    """Whether a search can split an estimator into stages and add effects to them."""
    if not isinstance(estimator, ScheduledParameters):
        return isinstance(estimator, ParametricModel)
    return estimator.degree == 1 and estimator.by != 0


@dataclass(frozen=True)
class Box:
    """What the black box of a contestant was fitted to, and its predictions.

    Attributes
    ----------
    records : tuple of RecordData
        With the out-of-fold predictions as the drive.
    predictions, targets : ndarray of shape (n_folds, n_samples)
        Predictions of the clone fitted without each fold, for all rows; and the targets of each
        fit.
    turns : int
        Number of times the black box was fitted again.
    """

    records: tuple
    predictions: np.ndarray
    targets: np.ndarray
    turns: int


class Declared:
    """A parametric model."""

    def __init__(self, estimator, columns, slices):
        self.model = estimator
        self._columns, self._slices = columns, slices

    def drive(self):
        """Return the drive of the records before :meth:`begin`."""
        return self._columns[:, 0]

    def effects(self, effects):
        """Return the effects that can be added to this model."""
        return effects

    def prepare(self, records, folds):
        """Return the records with the drive of the model, and the folds in which it is held out."""
        return records, folds

    def identified(self, records):
        """Return the identification result, and the tree of the identified model.

        The input history of the records is estimated where the declared model asks for it.
        """
        read, input_history = as_read(self.model, records), ()
        model, result = identified(self.model, read)
        if common_parameter(model, "initial_state") == "estimate":
            result = with_input_history(result, read, model.method)
            input_history = tuple(result.input_history)
        return result, Tree.from_result(model, result, input_history)

    def fitted(self, result):
        """Return the declared model with the parameters of an identification result."""
        self.model.records_ = self._slices
        return self.model.adopt(result)

    def driver(self):
        """Return the fitted estimator that drives the stages of the augmented model."""
        return self.model

    renew = None  # there is no black box to fit again

    def measured(self, records):
        """Return the records with the measured drive, the first column of X."""
        return records

    def augmented(self, contestant, records):
        """Return the model with the added effects, and its identification result."""
        estimator, result = contestant.structure.fitted(records, self._slices)
        return _knowing(estimator, self.model), result


class BlackBox(Declared):
    """Any regressor."""

    def __init__(self, estimator, X, columns, y, slices, random_state, reference):
        super().__init__(Gain(dt=common_parameter(estimator, "dt")), columns, slices)
        read_data(self.model, X, y, reset=True)
        self._estimator = _seeded(estimator, random_state)
        self._X, self._y, self._reference = X, y, reference

    def driver(self):
        return self._fitted

    def effects(self, effects):
        """Return the effects without those that act on the drive in front of the black box."""
        return [_without_drive_variants(effect) for effect in effects]

    def prepare(self, records, folds):
        # a fold whose fit uses all samples would be scored on samples that it was fitted to
        self._folds = folds = [own for own in folds if not own[0].all()]
        fold = np.zeros(len(self._y), dtype=int)
        # a segment that is not fitted belongs to the fold, whether it is scored or not
        stretches = [
            slice(s.rows.start + a, s.rows.start + b)
            for s, r in zip(self._slices, records, strict=True)
            for a, b in r.segments
        ]
        for k, (train, _) in enumerate(folds):
            for number in np.flatnonzero(~train):
                fold[stretches[number]] = k
        self._measured = records
        self._backfitting = Backfitting(self._estimator, self._X, self._slices, fold)
        targets = np.tile(self._y, (len(folds), 1))
        self._declared = self._box(targets, self._backfitting.predict(targets), 0, records)
        return list(self._declared.records), folds

    def _box(self, targets, predictions, turns, records):
        driven = self._driven(self._backfitting.out_of_fold(predictions), records)
        return Box(tuple(driven), predictions, targets, turns)

    def _driven(self, p, records):
        driven = [replace(r, u=p[s.rows]) for s, r in zip(self._slices, records, strict=True)]
        return driven if self._reference is None else self._reference.explain(driven)

    def fitted(self, result):
        """Return the declared estimator, fitted to all rows."""
        self._fitted = clone(self._estimator).fit(self._X, self._y)
        return self._fitted

    def renew(self, contestant, base, records, thorough=False):
        """Fit the black box and the effects in turn until the held-out error no longer falls.

        Parameters
        ----------
        contestant : Contestant
            Fitted to the predictions of ``base``, or ``base`` itself.
        base : Contestant
        records : list of RecordData
            Driven by the predictions of ``base``.
        thorough : bool, default=False
            Whether a small decrease of the error is worth another turn.

        Returns
        -------
        Contestant
            Held out, with its ``box``.
        """
        box = base.box if contestant.structure.effects and base.box else self._declared
        records = self._driven(self._backfitting.out_of_fold(box.predictions), records)
        contestant = held_out(contestant, records, self._folds)
        if contestant.structure.effects:

            def problem_of(contestant, p):
                return contestant.structure.problem(self._driven(p, records))

            def refit(contestant, predictions):
                seen = self._driven(self._backfitting.out_of_fold(predictions), records)
                found = held_out(
                    refitted(contestant, contestant.structure, seen), seen, self._folds
                )
                return found, found.error

            start = Turn(box.targets, box.predictions, contestant, contestant.error, box.turns)
            train = [train for train, _ in self._folds]
            fall = 0.1 * NOTICEABLE if thorough else NOTICEABLE
            last = self._backfitting.alternate(start, problem_of, refit, train, TURNS, fall)
            contestant = last.effects
            box = self._box(last.targets, last.predictions, last.number, records)
        return replace(contestant, box=box)

    def measured(self, records):
        return self._measured

    def augmented(self, contestant, records):
        effects, result = contestant.structure.fitted(records, self._slices)
        target = self._backfitting.merged(contestant.box.targets)
        self._fitted = clone(self._estimator).fit(self._X, target)
        parts, n_folds = (clone(self._estimator), clone(effects)), len(self._folds)
        model = Corrected(*parts, cv=n_folds, dt=self.model.dt)
        model.adopt(self._fitted, effects, self._slices, 1 + contestant.box.turns)
        return _knowing(model, self.model), result


def _knowing(estimator, other):
    """Return an estimator with the column names and the range of the drive of another one."""
    names = "n_features_in_", "feature_names_in_", "drive_range_", "drive_rate_", "input_range_"
    for name in names:
        if hasattr(other, name):
            setattr(estimator, name, getattr(other, name))
    return estimator


def _without_drive_variants(effect):
    """Return an effect without the variants that act on the drive."""
    return replace(effect, variants=partial(_variants_not_on_drive, effect))


def _variants_not_on_drive(effect):
    """Return the variants of an effect that do not act on the drive."""
    return [v for v in effect.variants() if hasattr(v, "trees") or v.stage_order > 0]


def _seeded(estimator, random_state):
    """Return the estimator with seeds where it has none, so that the search repeats."""
    if random_state is None:
        return estimator
    random_state = check_random_state(random_state)
    free = sorted(
        key
        for key, value in estimator.get_params().items()
        if value is None and key.split("__")[-1] == "random_state"
    )
    return estimator.set_params(**{key: random_state.randint(2**31 - 1) for key in free})


def drive_of(driver, X, columns, known=None):
    """Return the input of the stages behind a fitted ``driver``, see :meth:`Declared.driver`.

    The prediction continues a ``known`` response (n_samples,), NaN where unknown, where the driver
    can do so.
    """
    if _is_splittable(driver):
        return columns[:, 0]
    found = None if known is None else predicted_from(driver, X, known)
    return np.ravel(driver.predict(X) if found is None else found).astype(float)


def effect_of(driver, effect):
    """Return an effect as it applies behind a fitted ``driver``."""
    return effect if _is_splittable(driver) else _without_drive_variants(effect)
