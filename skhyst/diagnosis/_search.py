"""The search for the physical effect that a declared model lacks."""

import time
from collections.abc import Iterable
from dataclasses import replace
from numbers import Integral, Real
from os import PathLike
from typing import Literal, Self, overload

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, MetaEstimatorMixin, clone
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted
from threadpoolctl import threadpool_limits

from .._progress import watched
from .._sklearn import HasMethods, Interval, StrOptions, fit_context
from .._validation import ScoredMixin, refuse_no_experiment
from ..base import behind_gaps, read_data
from ..model_selection import by_content, segment_folds
from ..optimize import record_folds
from ..records import (
    data_quality,
    fill_lost_rows,
    first_of_equals,
    lost_readings,
    record_names,
    record_slices,
    resample_like,
    resample_records,
    resampling_error,
    with_reactions,
)
from ._black_box import declare
from ._candidates import Candidate, extrapolated, fitted, held_out
from ._checkpoint import Checkpoint
from ._claim import Claim
from ._constants import NEGLIGIBLE, REWEIGHTED
from ._contest import Contest
from ._criterion import Criterion
from ._effects import EFFECTS, chosen_effects
from ._evidence import gather_evidence
from ._inputs import (
    first_row,
    held_out_error,
    record_data,
    scoring_folds,
    units_of,
    with_others,
)
from ._location import locate, out_of_line, parameters_without
from ._outputs import response_columns, shared_claims
from ._reference import column_of, reference_of, without_column
from ._report import Report
from ._tables import (
    EXPLAINED,
    HISTORY,
    PARAMETERS_WITHOUT,
    RANKING,
    SUSPECTS,
    WithTables,
    cv_results,
)
from ._unknown import LAW_COLUMNS, Unknown, curve_of, find_unknown, laws_of
from ._verdict import Judgement, judge_residual


class EffectSearchCV(WithTables, MetaEstimatorMixin, ScoredMixin, BaseEstimator):
    """Find the physical effects that a declared model lacks, add them, and report the errors.

    The resolution of the declared model is fitted first. Then effects are added to the model, at
    data-driven starting values and refitted jointly with everything else, as long as they lower the
    held-out error. Each is tested against the whole model without it, with a correction for all
    that was tried, and removed if it is not needed. Each place is contested by all effects that
    helped, and named by the one of least error. The search ends when the error no longer falls.

    Parameters
    ----------
    estimator : estimator
        The declared model: any parametric model of skhyst or a cascade of them, to which effects
        are added; or any other regressor or pipeline. The out-of-fold prediction of such a
        regressor is then the drive of a gain with an offset, effects are added behind the gain or
        in parallel with it, and after each claim the regressor is fitted again to the response
        minus the contribution of the effects; effects that act on the drive before it are not
        tried.
    effects : "all" or list of str, default="all"
        Effects to try, see :func:`effect_names`. Where rows are missing within a record,
        ``"initial_state"`` is one of them: what follows begins in motion.
    cv : int, splitter or iterable, default=5
        What is held out, as in ``GridSearchCV``. An int: that many folds, each of a block of every
        record, or of a part of its period if the drive is periodic, see
        :func:`skhyst.model_selection.segment_folds`. A splitter, such as ``RecordKFold()`` for
        whole records; or an iterable of (train, test) row numbers.
    alpha : float, default=0.01
        Probability of a false claim.
    max_effects : int, default=3
        Largest number of effects in a model.
    min_improvement : float, default=0.05
        Fraction of the error that an effect must remove to be worth a claim, of the held-out error
        and of the error of the fit.
    loss : {"squared", "huber"}, default="squared"
        ``"huber"`` bounds the influence of gross errors of the measurement: samples whose residual
        deviates from its neighbours count less, or nothing, in fits and errors. The weights come
        from the residual at the start of each round.
    washout : int or None, default=None
        Samples at the start of each record that are simulated, but neither fitted nor scored. None:
        5 % of a block for a single record, whose past is unknown; none for several records, each of
        which starts from its own initial state.
    reference : int, str or None, default=None
        Position or name of the column of X that is the reference of the controller, if the drive
        was recorded in closed loop. Decisions are then based on the part of the drive that the
        reference explains, which is independent of the noise. It is no input: the estimator gets X
        without that column.
    resample : {"auto"}, float or None, default=None
        Treatment of unevenly sampled records. None: they are refused. "auto": drive, further
        columns and response are interpolated onto even grids, at intervals that
        :func:`skhyst.records.resample_records` derives; a float: at this interval, s. Everything
        then refers to the samples of these grids, including row numbers in ``cv``, ``washout`` and
        faults of the measurement; only :meth:`predict` returns values at the given instants.
    unknown : bool, default=False
        Whether a term without a name is sought if the residual is not noise, see ``unknown_``; for
        parametric models, without a reference and with records that begin at rest. If one is found,
        the verdict is ``"unexplained"``; all other results do not depend on it.
    n_jobs : int or None, default=None
        Number of processes. None is 1, or the number of joblib's context; -1 is all processors. The
        steps of a round are many and short, so that threads would wait for each other's interpreter
        lock; the processes start once, in a second or two, and serve later searches too.
    verbose : int, default=0
        Above 0, progress is written to the standard error stream: lines, and on a terminal or in a
        notebook a bar below them where rich is installed (in a notebook ipywidgets too).
    random_state : int, RandomState instance or None, default=None
        Seed of the black box that bounds the noise.
    checkpoint : path-like or None, default=None
        File in which finished steps are stored (skops). A search of the same data with the same
        parameters continues from there, with the same result; any other search is refused.

    Attributes
    ----------
    effects_ : list of str
        The claimed effects in the order in which they were added; empty if nothing is missing. With
        several responses, those that are claimed for all of them.
    searches_ : dict of str or int to EffectSearchCV
        If ``y`` has several columns: the search of each, by the name or number of the column, with
        all other attributes; this one has only these three, and predicts all columns.
    shared_ : DataFrame
        If ``y`` has several columns: effects that several ``responses`` have, and for each
        ``number`` of their evidence, such as a resonance frequency, its mean ``value`` over the
        responses, weighted by inverse variances, its ``std``, ``unit``, and the ``p_value`` of the
        scatter under a common value.
    verdict_ : {"noise", "unexplained", "undetermined"}
        Whether the residual is noise, or unexplained structure: repetitions share it, a black box
        predicts it, or it follows the drive better than the drive shifted in time. Undetermined: no
        structure is found, but the residual is too steep in frequency, too slow or too predictable
        for noise, or the held-out error is far larger than the noise, since records or blocks do
        not predict each other.
    verdict_reason_, verdict_advice_ : str
        What decided the verdict, and what to record if it is ``"undetermined"``.
    error_before_, error_after_ : float
        Root mean square error on held-out data of the declared and of the augmented model, units of
        the response, weighted by ``weights_``: on whole records if there are several, so that it
        holds for a new one, and on blocks of a single one, or as given by ``cv``. (The decisions of
        a search use ``cv``, and ``history_`` has those errors.) Constants that belong to a record
        (offset, drift, phase) are estimated from one half of a held-out record's segments to
        predict the other half.
    weights_ : ndarray of shape (n_samples,)
        Weight of each held-out sample: Huber's weights for that loss, ones otherwise.
    noise_floor_, noise_ceiling_ : float
        Bounds of the root mean square of the noise, units of the response. The floor is the least
        of the scatter between repetitions, of the innovations of the residual, and of the scaled
        differences of residual and response; no contestant is below it. The ceiling is the held-out
        error, or the part of it that a black box does not predict.
    noise_model_ : ~skhyst.noise.NoiseModel
        Colour, outliers and steps of the residual, or of the part that no black box predicts.
    history_ : DataFrame
        One row per claim, the effect that removes most of the error first: ``effect``,
        ``error_before``, ``error_after`` (of a sequence of models from which the effect that
        matters least is removed in each step), ``p_value`` (of the whole model against the model
        without the effect, corrected for all that was tried), ``ambiguous_with``, ``provisional``
        (the residual has structure, so that the name may stand for an effect that is not on the
        list), ``experiment``, ``evidence``.
    ranking_ : DataFrame
        Every candidate of every round: ``round``, ``with_effects`` (in the model), ``effect``,
        ``screen`` (part of the residual's power that it explains), ``error_before``,
        ``error_after``, ``p_value``, ``n_parameters``, ``claimed``.
    cv_results_ : dict of str to ndarray
        The rows of ``ranking_`` in the form of ``GridSearchCV``: ``params``, ``param_round``,
        ``param_effect``, ``split0_test_score`` and so on (the negative held-out error of each fold,
        NaN for a candidate that was not held out), ``mean_test_score``, ``std_test_score``,
        ``rank_test_score``.
    failed_ : DataFrame
        Candidates that raised an error, and were skipped: ``round``, ``effect``, ``error``.
    resolution_ : list of str
        Changes of the resolution of parts before effects were sought, such as "8 plays, the data
        ask for 23".
    dropped_ : list of str
        Effects that were added and removed again.
    unknown_ : Unknown or None
        With ``unknown``, the unexplained term: the place and the argument of the missing smooth
        function, its curve with a simultaneous band, errors, terms that the recording does not
        distinguish from it, laws that it resembles, and the ``estimator`` with it. None if no such
        term is significant, or the residual is noise.
    explained_ : dict of str to float
        What explains the response, as fractions of its variance, held out, which add up to one: the
        ``"declared model"``; of the rest, the ``"effects"`` and a raised resolution; then the
        ``"unknown term"``; then what a ``"black box"`` predicts or repetitions share; and
        ``"nothing"``.
    suspects_ : DataFrame
        Effects that are not claimed, those that would lower the held-out error most first:
        ``effect``, ``error_before``, ``error_after``, ``folds_better``, ``p_value``.
    warnings_ : list of str
        Warnings of the fits that a user should know, each once, and the records whose error is
        larger than that of the others, at the level ``alpha`` for all records, as it is and
        relative to their response.
    evidence_ : dict of str to Evidence
    reference_share_ : float or None
        Fraction of the drive's variance that the reference predicts; None without one.
    extrapolated_ : float
        Fraction of the held-out samples at which the drive is outside of the range that their fold
        was fitted to.
    data_quality_ : DataFrame
        Faults of the measurement, see :func:`~skhyst.records.data_quality`; they are reported, not
        removed. If the residual is noise, also whether the drive reacts to it (``closed_loop``),
        unless a reference is given.
    declared_estimator_, best_estimator_ : estimator
        Both fitted on all data. If a regressor other than a parametric model was declared, the
        augmented one is a :class:`~skhyst.compose.Corrected`.
    residual_location_ : DataFrame
        Distribution of the power of the residual, one row per record, tenth of its time, of the
        drive, of its amplitude (half of each swing) or of its rate, direction (-1 or 1), or octave:
        ``by``, ``record``, ``low``, ``high``, ``unit``, ``share`` of the power, and
        ``concentration``, mean power there relative to that of the whole, 1 for white noise, with
        its 95 % interval ``concentration_low``, ``concentration_high``, for all rows of a ``by`` at
        once. Useful if the verdict is ``"unexplained"``.
    parameters_without_ : DataFrame
        If the verdict is ``"unexplained"``, the parameters of fits without the samples at the
        strongest of these places (records, times, drive, amplitude, rate, direction): ``by``,
        ``record``, ``low``, ``high``, ``unit``, ``parameter``, ``value`` and ``std`` with all
        samples, ``value_without``, ``std_without``, and whether it has ``moved`` by more than its
        standard error explains, at the level ``alpha`` for all rows.
    residual_before_, residual_after_, prediction_before_, prediction_after_ : ndarray
        Held out, shape (n_samples,), NaN in the washout and at lost rows.
    records_ : tuple of RecordSlice
        Records of the samples of the arrays here: those of X, resampled if requested, with one
        sample for each lost row, see ``data_quality_``.
    folds_ : ndarray of shape (n_samples,)
        Number of the fold that scores each sample, -1 for none.
    drive_range_ : tuple of (float, float)
        Smallest and largest drive (column 0 of X) in the fit, units of the drive.
    drive_rate_ : float
        Largest rate of the drive between two samples of the fit, units of the drive per s.
    units_ : Units
        Of drive, response and time, see :class:`skhyst.records.Units`. Without a time, that is for
        data whose index counts samples with ``dt`` at 1, frequencies are in cycles/sample.
    drive_, response_ : ndarray of shape (n_samples,)
        The data of the search; on the even grids if the data were resampled.
    resampling_error_ : float
        Root mean square error of the interpolated response, its units, as estimated by
        :func:`skhyst.records.resampling_error`; 0 without resampling. An effect that removes less
        than that may be an artefact of the interpolation.
    seconds_ : dict of str to float

    See Also
    --------
    skhyst.model_selection.RecordKFold : Folds of whole records for scikit-learn's own tools.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.diagnosis import EffectSearchCV
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> rng = np.random.default_rng(0)
    >>> drive = np.cumsum(rng.normal(size=2000)) / 20
    >>> y = np.minimum(drive, np.quantile(drive, 0.8)) + 0.005 * rng.normal(size=2000)
    >>> search = EffectSearchCV(PrandtlIshlinskii(5), effects=["output_saturation", "offset"])
    >>> search.fit(drive.reshape(-1, 1), y).effects_
    ['output_saturation']
    """

    one_interval, largest_value = False, 1e30  # unless the model asks for one; squares are squared
    stepper = property(
        lambda self: self.best_estimator_.stepper, doc="That of the augmented model."
    )
    stepper_from = property(
        lambda self: self.best_estimator_.stepper_from, doc="That of the augmented model."
    )

    _parameter_constraints = {
        "estimator": [HasMethods(["fit", "predict"])],
        "effects": ["array-like", str],
        "cv": [
            Interval(Integral, 2, None, closed="left"),
            HasMethods(["split"]),
            "array-like",
            Iterable,
        ],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "max_effects": [Interval(Integral, 0, None, closed="left")],
        "min_improvement": [Interval(Real, 0, 1, closed="left")],
        "loss": [StrOptions({"huber", "squared"})],
        "washout": [Interval(Integral, 0, None, closed="left"), None],
        "reference": [Integral, str, None],
        "resample": [StrOptions({"auto"}), Interval(Real, 0, None, closed="neither"), None],
        "unknown": ["boolean"],
        "n_jobs": [Integral, None],
        "verbose": ["verbose"],
        "random_state": ["random_state"],
        "checkpoint": [str, PathLike, None],
    }

    def __init__(
        self,
        estimator,
        *,
        effects="all",
        cv=5,
        alpha=0.01,
        max_effects=3,
        min_improvement=0.05,
        loss="squared",
        washout=None,
        reference=None,
        resample=None,
        unknown=False,
        n_jobs=None,
        verbose=0,
        random_state=None,
        checkpoint=None,
    ):
        self.estimator = estimator
        self.effects = effects
        self.cv = cv
        self.alpha = alpha
        self.max_effects = max_effects
        self.min_improvement = min_improvement
        self.loss = loss
        self.washout = washout
        self.reference = reference
        self.resample = resample
        self.unknown = unknown
        self.n_jobs = n_jobs
        self.verbose = verbose
        self.random_state = random_state
        self.checkpoint = checkpoint

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # on data that no device has produced
        return tags

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y, *, on_progress=None) -> Self:
        """Search for missing effects.

        Sample weights are not supported: the tests assume that every sample counts once. Leave rows
        without a reading out of X and y; gaps of up to five rows are bridged.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the drive; the index carries records and time.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            Response; several columns are searched one after the other, see ``searches_``.
        on_progress : callable or None, default=None
            Called with a :class:`Progress` before each step and at each claim. An exception in it
            ends the search; the ``checkpoint`` keeps the finished steps.

        Returns
        -------
        self

        Raises
        ------
        RecordError
            If the response is constant or equal to a column of X, or the drive is the time.
        """
        for name in [name for name in vars(self) if name.endswith("_")]:
            delattr(self, name)  # if this fit is interrupted, nothing of an earlier one is left
        if columns := response_columns(y):
            return self._fit_each(X, columns, on_progress)
        effects = chosen_effects(self.effects)
        declared = clone(self.estimator)
        even, response = self._even(X, y)
        self.resampling_error_ = 0.0
        if even is not X:
            self.resampling_error_ = resampling_error(X, y, dt=self.resample)
        (X, y, self._read), given = fill_lost_rows(even, response), (even, response)
        slices, drive, response = read_data(self, X, y, reset=True)
        if behind_gaps(slices):  # otherwise a drift or another model explains how they begin
            effects = list({e.name: e for e in [*effects, EFFECTS["initial_state"]]}.values())
        at, columns = column_of(self), drive
        X, drive = without_column(X, at), without_column(drive, at)
        segments, folds = segment_folds(slices, self.cv, X, response, washout=self.washout)
        self.folds_ = scoring_folds(slices, segments, folds)
        refuse_no_experiment(columns, response, slices)
        self.data_quality_ = self._quality(given, (X, response, slices), at)
        reference = self._reference = reference_of(self, columns, slices)
        self.reference_share_ = None if at is None else reference.share
        declared = declare(declared, X, drive, response, slices, self.random_state, reference)
        self.response_name_ = str(getattr(y, "name", None) or "response")
        self.units_ = units_of(self, self.response_name_, slices)
        self.records_, self.drive_, self.response_ = slices, drive[:, 0].copy(), response.copy()
        self._whole = self._folds_of_records(slices, X, response)
        self._inputs = with_others(declared.drive(), drive)
        self.seconds_ = {}
        # the loops below run in parallel; nested threads would only cost time
        with (
            threadpool_limits(limits=1),
            watched(type(self).__name__, self.verbose, on_progress) as report_progress,
        ):
            self._search(declared, slices, effects, segments, folds, report_progress)
        return self

    def _fit_each(self, X, columns, on_progress):
        """Search each response separately."""
        searches = {}
        for name, y in columns.items():
            search = clone(self)
            if self.checkpoint is not None:
                search.set_params(checkpoint=f"{self.checkpoint}.{name}")
            searches[name] = search.fit(X, y, on_progress=on_progress)
        first, *others = searches.values()
        for name in ("n_features_in_", "feature_names_in_"):
            if hasattr(first, name):
                setattr(self, name, getattr(first, name))
        self.searches_, self.shared_ = searches, shared_claims(searches)
        self.effects_ = [e for e in first.effects_ if all(e in other.effects_ for other in others)]
        return self

    def __sklearn_is_fitted__(self):
        return hasattr(self, "failed_") or hasattr(self, "searches_")  # the last that is stored

    def _even(self, X, y=None):
        """Return the data on even grids, if that is requested and they are uneven."""
        if self.resample is None or not hasattr(X, "iloc"):
            return X, y
        even = resample_records(X, y, dt=self.resample)
        return (even, None) if y is None else even

    def _quality(self, given, filled, at):
        """Return the faults of the recording, numbered by its own rows if rows were lost."""
        if self._read is None:
            return data_quality(*filled)
        X, y = given
        return data_quality(
            without_column(X, at), y, record_slices(X, y, one_interval=False, bridge=True)
        )

    def _lost(self, slices):
        """Return masks (n_record,), one per record, of samples without a valid reading."""
        lost = lost_readings(self.drive_, self.response_, slices)
        if self._read is None:
            return lost
        return [mask | ~self._read[s.rows] for mask, s in zip(lost, slices, strict=True)]

    def _folds_of_records(self, slices, X, y):
        """Return segments and folds that hold out whole records; None for a single record."""
        firsts, order = first_of_equals(slices, X, y), by_content(slices, self.drive_, y)
        labels = list(dict.fromkeys(slices[firsts[i]].label for i in order))
        if not isinstance(self.cv, Integral) or len(labels) < 2:
            return None
        folds, count = [], min(self.cv, len(labels))
        for k in range(count):
            held = set(labels[k::count])
            test = [s for s, i in zip(slices, firsts, strict=True) if slices[i].label in held]
            rows = np.concatenate([np.arange(s.rows.start, s.rows.stop) for s in test])
            folds.append((np.setdiff1d(np.arange(len(y)), rows), rows))
        return segment_folds(slices, folds, X, y, washout=self.washout)

    def _by_records(self, slices, records, *candidates):
        """Return candidates held out in whole records, if there are several records."""
        if self._whole is None or candidates[0].box is not None:
            return candidates
        segments, folds = self._whole
        self.folds_ = scoring_folds(slices, segments, folds)
        records = [replace(r, segments=spans) for r, spans in zip(records, segments, strict=True)]
        return tuple(held_out(c, records, folds) for c in candidates)

    def _search(self, declared, slices, effects, segments, folds, report_progress):
        begin = time.perf_counter()
        records = [
            record_data(s, *self._inputs, self.response_, spans, self._read)
            for s, spans in zip(slices, segments, strict=True)
        ]
        if self._reference is not None:
            records = self._reference.explain(records)
        self.extrapolated_ = extrapolated(records, folds)
        records, folds = declared.prepare(records, folds)
        result, structure = declared.identified(records)
        problem = structure.problem(records)
        cost = result.error**2 * problem.segment_weight.sum()
        base = Candidate((), structure, cost, cost, len(result.x), result.x)
        base = first = held_out(base, records, folds)
        self.declared_estimator_ = declared.fitted(result)
        report_progress(f"declared model: held-out error {base.error:.4g}")
        self.seconds_["declared model"] = time.perf_counter() - begin
        contest = Contest(
            effects=declared.effects(effects),
            records=records,
            folds=folds,
            criterion=Criterion(self.alpha, self.min_improvement),
            max_effects=self.max_effects,
            n_jobs=self.n_jobs,
            negligible=NEGLIGIBLE * np.ptp(self.response_),
            report_progress=report_progress,
            renew=declared.renew,
            judge=lambda base: self._judged(declared.measured(contest.records), base, contest),
            lost=self._lost(slices) if self.loss == "huber" else None,
        )
        for _ in range(REWEIGHTED if contest.lost else 0):
            base = first = contest.weighed(base)
        if self.checkpoint is not None:
            kept = Checkpoint(self.checkpoint, self, self._inputs, self.response_, records, folds)
            contest.steps, contest.keep = kept.load(base), kept.save
            report_progress(f"{len(contest.steps)} steps are in {self.checkpoint}")
        contest.declared = base.structure
        base, raised = contest.raised(base)
        while True:
            better = contest.found(base)
            if not contest.criterion.improves_enough(base, better):
                break
            base, _ = contest.raised(contest.weighed(better))
        base, ambiguous = contest.named(base)
        history = contest.claims(base, ambiguous)
        self.resolution_ = [str(done) for done in raised]
        self.suspects_ = pd.DataFrame(contest.suspects(base), columns=SUSPECTS)
        self.seconds_ |= contest.seconds
        self._declared_structure = structure
        self._conclude(declared, slices, contest, first, base, history, result)

    def _conclude(
        self, declared, slices, contest, first: Candidate, base: Candidate, history, declared_fit
    ):
        """Store the results of a search: of the declared model, and of the final candidate."""
        records = contest.records_of(base)
        begin = time.perf_counter()
        decided, (first, base) = base, self._by_records(slices, records, first, base)
        self.error_before_: float = first.error
        self.error_after_: float = base.error
        self.effects_: list[str] = [row["effect"] for row in history]
        self.dropped_ = [n for n in dict.fromkeys(contest.dropped) if n not in self.effects_]
        self.residual_before_: np.ndarray = np.concatenate(first.residuals)
        self.residual_after_: np.ndarray = np.concatenate(base.residuals)
        self.prediction_before_: np.ndarray = np.concatenate(first.predictions)
        self.prediction_after_: np.ndarray = np.concatenate(base.predictions)
        pairs = zip(base.residuals, base.weights, strict=True)
        self.weights_ = np.concatenate([np.ones(len(e)) if w is None else w for e, w in pairs])
        ranking = contest.ranking
        self._judge(contest.judgement(decided), ranking)
        if self.verdict_ == "noise" and self._reference is None:
            _, residuals = fitted(base, records, (first_row(self, s) for s in slices))
            self.data_quality_ = with_reactions(self.data_quality_, self.drive_, residuals, slices)
        self.residual_location_ = locate(slices, self.drive_, self.residual_after_, self.units_)
        self.seconds_["noise floor"] = time.perf_counter() - begin
        self.unknown_: Unknown | None = self._unknown(declared, slices, contest, decided)
        self.explained_ = self._explained(contest.judgement(decided).unpredicted)
        begin = time.perf_counter()
        del self._inputs, self._reference, self._whole, self._read
        self._structure, self._records = base.structure, tuple(records)
        self.best_estimator_, result = self.declared_estimator_, None
        if self.effects_ or self.resolution_:
            self.best_estimator_, result = declared.augmented(base, records)
        self.parameters_without_ = pd.DataFrame(columns=PARAMETERS_WITHOUT)
        if self.verdict_ == "unexplained" and contest.renew is None:
            data = slices, records, self.drive_, self.residual_location_
            self.parameters_without_ = parameters_without(
                base.structure, *data, result or declared_fit, self.alpha
            )
        self._driver = declared.driver()
        fits = (self.declared_estimator_, declared_fit), (self.best_estimator_, result)
        self.warnings_ = self._warnings(first, fits, records)
        columns, self.evidence_ = list(getattr(self, "feature_names_in_", ())), {}
        if columns and self.reference is not None:
            del columns[column_of(self)]
        for number, row in enumerate(history, 1):
            effect = EFFECTS[row["effect"]]
            model = base.structure, result, tuple(records), tuple(columns), self.units_
            row["evidence"] = gather_evidence(
                Claim(effect, *model),
                row["error_before"],
                row["error_after"],
                self.effects_[number:],
            )
            row["provisional"] = self.verdict_ == "unexplained"
            self.evidence_[effect.name] = row["evidence"]
        self.history_ = pd.DataFrame(history, columns=HISTORY)
        last = {row["effect"]: number for number, row in enumerate(ranking)}
        ranking = [
            row | {"claimed": row["effect"] in self.effects_ and last[row["effect"]] == number}
            for number, row in enumerate(ranking)
        ]
        self.ranking_ = pd.DataFrame(ranking, columns=RANKING)
        self.cv_results_ = cv_results(ranking, len(contest.folds))
        self.failed_ = pd.DataFrame(contest.failed, columns=["round", "effect", "error"])
        self.seconds_["refit and evidence"] = time.perf_counter() - begin

    def _explained(self, unpredicted):
        """Return what explains the response, as fractions of its variance."""
        known = np.isfinite(self.residual_before_)
        y, weights = self.response_[known], self.weights_[known]
        whole = np.average(np.square(y - np.average(y, weights=weights)), weights=weights)
        after, term = self.error_after_, self.unknown_
        ends = after, after * unpredicted**0.5
        if term is not None:
            last = term.second or term
            ends = last.error_after, last.noise_ceiling
        power = np.append(whole, np.square([self.error_before_, after, *ends]))
        unexplained = np.append(np.minimum.accumulate(power) / (whole or 1.0), 0.0)
        return dict(zip(EXPLAINED, (unexplained[:-1] - unexplained[1:]).tolist(), strict=True))

    def _unknown(self, declared, slices, contest, base):
        """Return the term without a name that a candidate lacks, or None."""
        self._undistinguished = []  # name and tree of a term, and of one that is ambiguous with it
        if not self.unknown or self.verdict_ == "noise" or self._reference is not None:
            return None
        if contest.renew is not None:  # a black box has no joints
            return None
        begin = time.perf_counter()
        data = contest.records_of(base), slices, contest.folds
        how = contest.criterion, contest.n_tried, self.n_jobs, contest.judgement
        terms, unknown = find_unknown(base, data, *how), None
        for term in reversed(terms):
            first = str(term.site), term.candidate.structure
            self._undistinguished += [(*first, site, c.structure) for site, c in term.ambiguous]
            unknown = self._term(term, data, contest, declared, unknown)
        if unknown is not None and self.verdict_ == "undetermined":
            # a significant term is structure
            self.verdict_, self.verdict_advice_ = "unexplained", ""
            self.verdict_reason_ = "a smooth function of a signal explains it"
        self.seconds_["unknown term"] = time.perf_counter() - begin
        return unknown

    def _term(self, term, data, contest, declared, second):
        """Return the description of a term, with that of the second one."""
        records, slices, _ = data
        before, after = self._by_records(slices, records, term.base, term.candidate)
        judged = contest.judgement(term.candidate)
        estimator, _ = declared.augmented(term.candidate, records)
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31 - 1))
        return Unknown(
            term.site.where,
            term.site.argument,
            curve_of(term.site, term.candidate.structure, records, rng),
            before.error,
            after.error,
            max(1.0 - (after.error / before.error) ** 2, 0.0),
            term.p_value,
            tuple(site for site, _ in term.ambiguous),
            pd.DataFrame(laws_of(term, data, contest.criterion), columns=LAW_COLUMNS),
            judged.verdict != "noise",
            after.error * judged.unpredicted**0.5,
            estimator,
            second,
            term.site.second,
        )

    def _warnings(self, first, fits, records):
        """Return the warnings of the fits that a user should know, each once."""
        messages = []
        if not np.ptp(self.drive_):
            messages.append(
                f"The drive does not move: it is {self.drive_[0]:g} in every sample. No effect "
                "that responds to it can be found."
            )
        # error of a straight line over the drive, held out like the declared model
        line = np.stack([self.drive_, np.ones(len(self.drive_))], axis=1)
        by_line, known = np.full(len(line), np.nan), np.isfinite(self.residual_before_)
        for fold in np.unique(self.folds_[known]):
            test = self.folds_ == fold
            train = known & ~test
            coefficients = np.linalg.lstsq(line[train], self.response_[train], rcond=None)[0]
            by_line[test] = self.response_[test] - line[test] @ coefficients
        power = np.average(np.square(by_line[known]), weights=self.weights_[known])
        if (1.0 - self.min_improvement) * first.error > np.sqrt(power):
            messages.append(
                "The declared model explains less of the response than a straight line over the "
                "drive does: see the page 'Which model should I declare?' of the documentation."
            )
        for model, result in fits:
            if result is not None and hasattr(model, "fit_warnings"):
                messages += [message for message, _ in model.fit_warnings(result, records)]
        residuals, responses = (
            [values[s.rows] for s in self.records_]
            for values in (self.residual_after_, self.response_)
        )
        criterion, names = Criterion(self.alpha, self.min_improvement), record_names(self.records_)
        messages += [
            f"The error of record {names[number]} is {ratio:.3g} times that of the others: it may "
            "have been recorded under other conditions."
            for number, ratio in out_of_line(residuals, responses, criterion).items()
        ]
        return list(dict.fromkeys(messages))

    def _judge(self, judgement, ranking):
        """Set the verdict, the noise model, and the noise floor and ceiling."""
        self.verdict_ = judgement.verdict
        self.verdict_reason_, self.verdict_advice_ = judgement.reason, judgement.advice
        errors = [row["error_after"] for row in ranking]
        self.noise_floor_ = float(np.nanmin([judgement.floor, *errors]))
        self.noise_ceiling_, self.noise_model_ = judgement.ceiling, judgement.noise

    def _judged(self, measured, base, contest):
        """Return the judgement of the residual of a candidate that is fitted to all data.

        The held-out error is the larger of that in folds and in whole records. A record whose drive
        exceeds the range of the others is not held out, since its error would show extrapolation,
        not missing structure.
        """
        if base.error <= contest.negligible:
            return Judgement.of_rounding(base.error)
        in_loop, records = self._reference is not None, contest.records_of(base)
        starts = [first_row(self, s) for s in self.records_]
        predictions, residuals = fitted(base, records, starts)
        if in_loop:
            predictions, _ = fitted(base, records, starts, by_reference=True)
            measured = self._reference.in_place(measured)
        order = by_content(self.records_, self.drive_, self.response_)
        seen = [[part[i] for i in order] for part in (measured, residuals, predictions)]
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31 - 1))
        whole = record_folds(records) if base.box is None else []
        error = max(base.error, held_out(base, records, whole).error) if whole else base.error
        return judge_residual(*seen, rng, contest.criterion, error=error, in_loop=in_loop)

    @overload
    def predict(self, X, y_start=None, return_std: Literal[False] = False) -> np.ndarray: ...
    @overload
    def predict(
        self, X, y_start=None, *, return_std: Literal[True]
    ) -> tuple[np.ndarray, np.ndarray]: ...
    def predict(
        self, X, y_start=None, return_std=False
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the free-run prediction of the augmented model.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`. With ``resample``, an unevenly sampled drive is simulated on even
            grids.
        y_start : array-like of shape (n_samples,) or (n_samples, n_outputs), default=None
            Known values of the response, NaN elsewhere, as for ``predict`` of the model.
        return_std : bool, default=False
            Whether to return the standard deviation of the prediction of a new sample, too.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            Units of the response; interpolated at the instants of ``X`` if it was resampled.
        std : ndarray of the shape of y
            Only with ``return_std``; from the covariance of the final model's parameters, without
            the uncertainty of the selection of effects.

        Raises
        ------
        ValueError
            If ``y_start`` is given for an unevenly sampled drive.
        """
        check_is_fitted(self)
        options = {"return_std": True} if return_std else {}
        if hasattr(self, "searches_"):
            started = [{}] * len(self.searches_)
            if y_start is not None:
                started = [{"y_start": part} for part in response_columns(y_start).values()]
            searches = zip(self.searches_.values(), started, strict=True)
            parts = [search.predict(X, **start, **options) for search, start in searches]
            predicted = np.moveaxis(parts, 0, -1)
            return (predicted[0], predicted[1]) if return_std else predicted
        inputs = even = self._even(X)[0]
        if y_start is not None and even is not X:
            raise ValueError(
                "The 'y_start' parameter of EffectSearchCV.predict must be None where 'resample' "
                "is not: resample the recording before."
            )
        if self.reference is not None:
            read_data(self, even, reset=False)
            inputs = without_column(even, column_of(self))
        options |= {} if y_start is None else {"y_start": y_start}
        predicted = self.best_estimator_.predict(inputs, **options)
        if even is X:
            return predicted
        parts = [resample_like(pd.Series(y, even.index), X) for y in np.atleast_2d(predicted)]
        return tuple(parts) if return_std else parts[0]

    def held_out_error(self, X, y, *, declared=False) -> float:
        """Return the root mean square error on records that the search has not seen.

        Constants that belong to a record (offset, drift, phase) are estimated from every other
        segment of it to predict the segments in between, and vice versa. The input history is
        estimated from the record itself if records begin in motion (``initial_state``) or the
        record continues one of the fit, and the error is then enlarged by Akaike's factor; a
        regressor other than a parametric model continues from the washout of such a record if its
        ``predict`` has ``y_start``. The washout at each record's start is not scored.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Response.
        declared : bool, default=False
            Whether to return the error of the declared model instead of the augmented one.

        Returns
        -------
        float or ndarray of shape (n_outputs,)
            Units of the response.
        """
        check_is_fitted(self)
        if hasattr(self, "searches_"):
            columns = zip(self.searches_.values(), response_columns(y).values(), strict=True)
            return np.array([own.held_out_error(X, v, declared=declared) for own, v in columns])
        return held_out_error(self, *self._even(X, y), declared)

    def report(self, command=None) -> Report:
        """Return the report of the search: HTML, Markdown, JSON.

        Parameters
        ----------
        command : str, default=None
            The command that made the report, shown in it.

        Returns
        -------
        Report
            Of the fitted search.
        """
        check_is_fitted(self)
        if hasattr(self, "searches_"):
            raise ValueError(
                "Several responses have a report each: take that of one of 'searches_', which are "
                f"those of {', '.join(map(repr, self.searches_))}."
            )
        return Report.from_search(self, command=command)

    def _with_result(self, diagram):
        """Return the HTML of a notebook: the result, if there is one, above the diagram."""
        fitted = hasattr(self, "verdict_") and not hasattr(self, "searches_")
        return (self.report()._repr_html_() if fitted else "") + diagram

    def _repr_html_inner(self):
        return self._with_result(super()._repr_html_inner())

    def _repr_mimebundle_(self, **options):
        bundle = super()._repr_mimebundle_(**options)
        if "text/html" in bundle:
            bundle["text/html"] = self._with_result(bundle["text/html"])
        return bundle
