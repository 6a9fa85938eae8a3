"""The search for the physical effect that a declared model lacks."""

import sys
import time
from dataclasses import replace
from itertools import pairwise
from numbers import Integral, Real

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from sklearn.base import BaseEstimator, MetaEstimatorMixin, RegressorMixin, clone
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted
from threadpoolctl import threadpool_limits

from .._sklearn import HasMethods, Interval, fit_context
from ..base import ParametricModel, read_data
from ..optimize import RecordData
from ._contest import Contestant, contest, held_out, paired_p_value, screen
from ._data_quality import data_quality
from ._effects import EFFECTS
from ._evidence import gather_evidence
from ._location import locate
from ._noise import black_box_gain, repeatability
from ._report import Report
from ._structure import Structure

__all__ = ["EffectSearchCV"]

_SEGMENTS = 32  # a record
_SHORTEST_SEGMENT = 16  # samples
_CONTESTED = 6  # candidates of a round that are refitted jointly, at the most
_ALWAYS_CONTESTED = 3
_HOPEFUL = 16.0  # sum of squares after screening, relative to the best, for the others of these
_CLOSE = 4.0  # sum of squares, relative to the best, up to which a candidate is held out
_SAME_ERROR = 0.005  # relative difference of held-out errors that is no difference
_SIMILAR_ERROR = 0.05  # by so much a simpler candidate may be worse, if the data allow
_WASHOUT = 0.05  # of a block of a single record
_NEGLIGIBLE = 1e-7  # held-out error, relative to the range, below which nothing is sought
_UNEXPLAINED = 0.03  # part of the residual's power that a black box predicts


class EffectSearchCV(MetaEstimatorMixin, RegressorMixin, BaseEstimator):
    """Find the physical effects that a declared model lacks, add them, and report the errors.

    Each round screens every effect (its model is put at its place and refitted briefly from
    data-driven starting values), lets the best contest on held-out data after a joint refit of
    everything, and claims one whose improvement is significant after correction for the number
    of candidates, large enough to matter, and not reached by a simpler one. It stops when no
    effect qualifies.

    Parameters
    ----------
    estimator : estimator
        The declared model: any parametric model of skhyst or a cascade of them.
    effects : "all" or list of str, default="all"
        Effects to try, see :func:`effect_names`.
    cv : int, default=5
        Number of folds. Folds are whole records; a single record is cut into contiguous blocks.
    alpha : float, default=0.01
        Probability of a false claim.
    max_effects : int, default=3
        Number of effects after which the search ends.
    min_improvement : float, default=0.05
        Part of the held-out error that an effect must remove to be worth a claim.
    washout : int or None, default=None
        Samples at the start of each block, or of each record, that are simulated but not scored.
        None: 5 % of a block of a single record, whose past is unknown; nothing where there are
        several records, each from its own start.
    n_jobs : int or None, default=None
        Processes. None is 1, or what joblib's context says; -1 is all processors. A round's steps
        are many and short, so that threads would wait for each other's interpreter lock; the
        processes start once, in a second or two, and serve later searches too.
    verbose : int, default=0
        Above 0, progress is written to the standard error stream.
    random_state : int, RandomState instance or None, default=None
        Seed of the black box that bounds the noise.

    Attributes
    ----------
    effects_ : list of str
        The claimed effects in the order in which they were added; empty when nothing is missing.
    verdict_ : {"noise", "unexplained"}
        Whether what is left is noise, or structure that no effect explains.
    error_before_, error_after_ : float
        Root mean square error on held-out data of the declared and of the augmented model, units
        of the response. Constants that belong to a record (offset, drift, phase) are taken from
        one half of a held-out record's segments to predict the other half.
    noise_floor_ : float
        The error that no model can beat: from repetitions, else what a black box leaves.
    history_ : DataFrame
        One row a claim: ``effect``, ``error_before``, ``error_after``, ``p_value``,
        ``ambiguous_with``, ``experiment``, ``evidence``.
    ranking_ : DataFrame
        Every candidate of every round: ``round``, ``effect``, ``screen`` (part of the residual's
        power that it explains), ``error_before``, ``error_after``, ``p_value``, ``n_parameters``,
        ``claimed``.
    evidence_ : dict of str to Evidence
    data_quality_ : DataFrame
        Faults of the measurement, see :func:`data_quality`; they are reported, not removed.
    declared_estimator_, best_estimator_ : estimator
        Both fitted on all data.
    residual_location_ : DataFrame
        How the power of what is left is spread over records, time, drive, rate and frequency: see
        ``concentration``. Of use where the verdict is ``"unexplained"``.
    residual_before_, residual_after_, prediction_before_, prediction_after_ : ndarray
        Held out, shape (n_samples,), NaN in the washout.
    records_ : tuple of RecordSlice
    drive_, response_ : ndarray of shape (n_samples,)
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

    _parameter_constraints = {
        "estimator": [HasMethods(["fit", "predict"])],
        "effects": ["array-like", str],
        "cv": [Interval(Integral, 2, None, closed="left")],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "max_effects": [Interval(Integral, 0, None, closed="left")],
        "min_improvement": [Interval(Real, 0, 1, closed="left")],
        "washout": [Interval(Integral, 0, None, closed="left"), None],
        "n_jobs": [Integral, None],
        "verbose": ["verbose"],
        "random_state": ["random_state"],
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
        washout=None,
        n_jobs=None,
        verbose=0,
        random_state=None,
    ):
        self.estimator = estimator
        self.effects = effects
        self.cv = cv
        self.alpha = alpha
        self.max_effects = max_effects
        self.min_improvement = min_improvement
        self.washout = washout
        self.n_jobs = n_jobs
        self.verbose = verbose
        self.random_state = random_state

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # on data that no device has produced
        return tags

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y):
        """Search.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the drive; the index carries records and time.
        y : array-like of shape (n_samples,)
            Response.

        Returns
        -------
        self
        """
        effects = self._chosen_effects()
        if not isinstance(self.estimator, ParametricModel):
            raise TypeError(
                "The 'estimator' parameter of EffectSearchCV must be a parametric model of skhyst "
                f"or a Cascade of such models. Got {self.estimator!r} instead."
            )
        declared = clone(self.estimator)
        slices, drive, response = read_data(self, X, y, reset=True, dt=getattr(declared, "dt", 1.0))
        read_data(declared, X, y, reset=True, dt=declared.dt)
        self.response_name_ = str(getattr(y, "name", None) or "response")
        self.records_, self.drive_, self.response_ = slices, drive[:, 0].copy(), response.copy()
        self.data_quality_ = data_quality(X if hasattr(X, "iloc") else drive, response, slices)
        self.seconds_ = {}
        # the loops below run side by side; a second layer of threads below only costs
        with threadpool_limits(limits=1):
            self._search(declared, slices, effects)
        return self

    def _chosen_effects(self):
        if isinstance(self.effects, str):
            if self.effects == "all":
                return list(EFFECTS.values())
            names = [self.effects]
        else:
            names = list(self.effects)
        unknown = [name for name in names if name not in EFFECTS]
        if unknown:
            raise ValueError(
                "The 'effects' parameter of EffectSearchCV must be 'all' or names among "
                f"{', '.join(EFFECTS)}. Got {', '.join(map(repr, unknown))} instead."
            )
        return [EFFECTS[name] for name in names]

    def _cut(self, slices):
        """Return the records with their segments, and the folds over segments."""
        single = len(slices) == 1
        n_folds = self.cv if single else min(self.cv, len(slices))
        records, fold_of, washed = [], [], []
        for number, s in enumerate(slices):
            n = s.n_samples
            blocks = np.linspace(0, n, (n_folds if single else 1) + 1).astype(int)
            washout = self._washed(n // (len(blocks) - 1), single)
            segments = []
            for block, (first, last) in enumerate(pairwise(blocks)):
                start = min(first + washout, last - 1)
                count = max(
                    min(_SEGMENTS // (len(blocks) - 1), (last - start) // _SHORTEST_SEGMENT), 1
                )
                parts = _stretches(start, last, count)
                flags = [False] * len(parts)
                if start > first:
                    parts.insert(0, (int(first), int(start)))
                    flags.insert(0, True)
                segments += parts
                washed += flags
                fold_of += [block if single else number % n_folds] * len(parts)
            records.append(_record_data(s, self.drive_, self.response_, segments))
        fold_of, washed = np.array(fold_of), np.array(washed)
        # a washed-out stretch belongs to a block: it is fitted with other blocks, never scored
        folds = [(fold_of != k, (fold_of == k) & ~washed) for k in range(n_folds)]
        return records, folds

    def _washed(self, n_samples, single):
        """Return the number of samples at the start of a block that are not scored."""
        if self.washout is not None:
            return self.washout
        return int(_WASHOUT * n_samples) if single else 0

    def _search(self, declared, slices, effects):
        begin = time.perf_counter()
        records, folds = self._cut(slices)
        if len(records) == 1 and len(self.response_) < 2 * self.cv:
            raise ValueError(
                f"EffectSearchCV needs at least {2 * self.cv} samples for {self.cv} folds. "
                f"Got {len(self.response_)} instead."
            )
        result = declared._identify(records)
        structure = Structure.from_result(declared, result)
        problem = structure.problem(records)
        cost = result.error**2 * problem.segment_length.sum()
        base = Contestant("", structure, cost, len(result.x), result.x)
        base = held_out(base, records, folds)
        declared._adopt(result)
        declared.records_ = slices
        self.declared_estimator_ = declared
        self._say(f"declared model: held-out error {base.error:.4g}")
        self.seconds_["declared model"] = time.perf_counter() - begin
        first = base
        history, ranking = [], []
        groups = problem.segment_record
        negligible = _NEGLIGIBLE * np.ptp(self.response_)
        while len(history) < self.max_effects and base.error > negligible:
            taken = {row["effect"] for row in history}
            candidates = [effect for effect in effects if effect.name not in taken]
            winner, rows = self._round(base, candidates, records, folds, groups, len(history) + 1)
            ranking += rows
            if winner is None:
                break
            contestant, row = winner
            history.append(row)
            base = contestant
            self._say(
                f"round {len(history)}: {row['effect']}, held-out error "
                f"{row['error_before']:.4g} -> {row['error_after']:.4g}"
            )
        begin = time.perf_counter()
        self.error_before_, self.error_after_ = first.error, base.error
        self.effects_ = [row["effect"] for row in history]
        for name, contestant in (("before", first), ("after", base)):
            setattr(self, f"residual_{name}_", np.concatenate(contestant.residuals))
            setattr(self, f"prediction_{name}_", np.concatenate(contestant.predictions))
        self._judge(records, base)
        self.residual_location_ = locate(records, base.residuals, [s.label for s in slices])
        self.seconds_["noise floor"] = time.perf_counter() - begin
        begin = time.perf_counter()
        self._structure = base.structure
        self.best_estimator_, result = base.structure.fitted(declared, records, slices)
        self.best_estimator_.n_features_in_ = self.n_features_in_
        if hasattr(self, "feature_names_in_"):
            self.best_estimator_.feature_names_in_ = self.feature_names_in_
        self._declared_structure = structure
        self.evidence_ = {
            row["effect"]: gather_evidence(
                EFFECTS[row["effect"]], base.structure, result, records, first, base
            )
            for row in history
        }
        for row in history:
            row["evidence"] = self.evidence_[row["effect"]]
        columns = [
            "effect",
            "error_before",
            "error_after",
            "p_value",
            "ambiguous_with",
            "experiment",
            "evidence",
        ]
        self.history_ = pd.DataFrame(history, columns=columns)
        columns = [
            "round",
            "effect",
            "screen",
            "error_before",
            "error_after",
            "p_value",
            "n_parameters",
            "claimed",
        ]
        self.ranking_ = pd.DataFrame(ranking, columns=columns)
        self.seconds_["refit and evidence"] = time.perf_counter() - begin

    def _round(self, base, effects, records, folds, groups, number):
        """Screen and contest; return the winner with its row of the history, and the ranking."""
        begin = time.perf_counter()
        parallel = Parallel(n_jobs=self.n_jobs, batch_size=1)
        screened = parallel(delayed(screen)(effect, base.structure, records) for effect in effects)
        least = {e.name: cost for e, (_, cost) in zip(effects, screened, strict=True)}
        added = {
            effect.name: min(starts[0].n_parameters for starts in found) - base.n_parameters
            for effect, (found, _) in zip(effects, screened, strict=True)
        }
        promising = [
            (cost, found)
            for found, cost in screened
            if cost < (1.0 - self.min_improvement) * base.cost
        ]
        promising.sort(key=lambda pair: pair[0])
        promising = [
            found
            for place, (cost, found) in enumerate(promising[:_CONTESTED])
            if place < _ALWAYS_CONTESTED or cost <= _HOPEFUL * promising[0][0]
        ]
        self._add_time("screening", begin)
        begin = time.perf_counter()
        refitted = contest(promising, records, parallel)
        lowest = min((c.cost for c in refitted), default=0.0)
        finalists = parallel(
            delayed(held_out)(c, records, folds) for c in refitted if c.cost <= _CLOSE * lowest
        )
        self._add_time("contest", begin)
        tested = {}
        for finalist in finalists:
            p = paired_p_value(base.squared_errors, finalist.squared_errors, groups)
            tested[finalist.effect] = replace(finalist, p_value=min(1.0, p * len(effects)))
        claims = [
            c
            for c in tested.values()
            if c.p_value < self.alpha
            and c.error < (1.0 - self.min_improvement) * base.error
            and _is_plausible(EFFECTS[c.effect], c.structure)
        ]
        winner = None
        if claims:
            winner = self._choose(base, claims, groups)
        rows = []
        for effect in effects:
            c = tested.get(effect.name)
            rows.append(
                {
                    "round": number,
                    "effect": effect.name,
                    "screen": round(max(1.0 - least[effect.name] / base.cost, 0.0), 9),
                    "error_before": base.error,
                    "error_after": c.error if c else np.nan,
                    "p_value": c.p_value if c else np.nan,
                    "n_parameters": c.n_parameters - base.n_parameters if c else added[effect.name],
                    "claimed": winner is not None and winner[0].effect == effect.name,
                }
            )
        return winner, rows

    def _choose(self, base, claims, groups):
        """Return the simplest of the claims that the data cannot tell from the best."""
        best = min(claims, key=lambda c: c.error)
        same = [
            c
            for c in claims
            if c.error <= (1.0 + _SAME_ERROR) * best.error
            or paired_p_value(c.squared_errors, best.squared_errors, groups) > self.alpha
        ]
        near = [c for c in same if c.error <= (1.0 + _SIMILAR_ERROR) * best.error]
        chosen = min(near, key=lambda c: (c.n_parameters, c.error))
        others = tuple(c.effect for c in sorted(same, key=lambda c: c.error) if c is not chosen)
        row = {
            "effect": chosen.effect,
            "error_before": base.error,
            "error_after": chosen.error,
            "p_value": chosen.p_value,
            "ambiguous_with": others,
            "experiment": EFFECTS[chosen.effect].experiment if others else "",
        }
        return chosen, row

    def _judge(self, records, base):
        """Set the noise floor and the verdict."""
        floor = repeatability(records)
        if base.error <= _NEGLIGIBLE * np.ptp(self.response_):
            self.noise_floor_ = base.error if floor is None else floor
            self.verdict_ = "noise"
            return
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31 - 1))
        # of the fit to everything: a held-out record that goes further than the others shows what
        # they do not determine, which is no missing structure
        residuals, predictions = self._fitted(records, base)
        error, p_value = black_box_gain(records, residuals, predictions, rng)
        power = np.nanmean(np.square(np.concatenate(residuals)))
        gain = 1.0 - error**2 / power if power > 0.0 else 0.0
        structured = p_value < self.alpha and gain > _UNEXPLAINED
        if floor is None:
            floor = error if structured else base.error
        self.noise_floor_ = floor
        self.verdict_ = "unexplained" if structured else "noise"

    @staticmethod
    def _fitted(records, base):
        """Return residuals and predictions of the fit to all records, NaN where nothing counts."""
        problem = base.structure.problem(records)
        fitted = problem.predictions(problem.x0, np.ones(len(problem.segment_record), dtype=bool))
        predictions = [
            np.where(np.isfinite(held_out), prediction, np.nan)
            for held_out, prediction in zip(base.predictions, fitted, strict=True)
        ]
        return [r.y - p for r, p in zip(records, predictions, strict=True)], predictions

    def _add_time(self, stage, begin):
        self.seconds_[stage] = self.seconds_.get(stage, 0.0) + time.perf_counter() - begin

    def _say(self, text):
        if self.verbose:
            print(f"[EffectSearchCV] {text}", file=sys.stderr, flush=True)

    def predict(self, X):
        """Return the free run of the augmented model, shape (n_samples,)."""
        check_is_fitted(self)
        return self.best_estimator_.predict(X)

    def held_out_error(self, X, y, *, declared=False):
        """Return the root mean square error on records that the search has not seen.

        Constants that belong to a record (offset, drift, phase) are taken from every other
        segment of it to predict the segments between, and the other way round. The washout at
        each record's start is predicted but not scored.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
        y : array-like of shape (n_samples,)
        declared : bool, default=False
            Whether the error is that of the declared model instead of the augmented one.

        Returns
        -------
        float
            Units of the response.
        """
        check_is_fitted(self)
        slices, drive, response = read_data(self, X, y, reset=False, dt=self.estimator.dt)
        records = []
        for s in slices:
            start = min(self._washed(s.n_samples, len(self.records_) == 1), s.n_samples - 1)
            count = max(min(_SEGMENTS, (s.n_samples - start) // _SHORTEST_SEGMENT), 1)
            segments = _stretches(start, s.n_samples, count)
            records.append(_record_data(s, drive[:, 0], response, segments))
        structure = self._declared_structure if declared else self._structure
        problem = structure.problem(records)
        nothing = np.zeros(len(problem.segment_record), dtype=bool)
        parts = problem.predictions(problem.x0, nothing)
        errors = np.concatenate(
            [(r.y - p)[r.segments[0][0] :] for r, p in zip(records, parts, strict=True)]
        )
        return float(np.sqrt(np.mean(np.square(errors))))

    def report(self, command=None):
        """Return the :class:`Report`: HTML, Markdown, JSON."""
        check_is_fitted(self)
        return Report.from_search(self, command=command)


def _record_data(s, drive, response, segments):
    return RecordData(drive[s.rows], response[s.rows], s.dt, segments=tuple(segments))


def _is_plausible(effect, structure):
    """Tell whether the identified effect is still what its name says."""
    if effect.plausible is None:
        return True
    if effect.beside:
        operators = dict(zip(structure.beside_names, structure.disturbances, strict=True))
    else:
        operators = dict(zip(structure.names, structure.operators, strict=True))
    return effect.plausible(operators[effect.name])


def _stretches(start, stop, count):
    """Cut rows into ``count`` stretches of one length; the last takes what is over."""
    length = (stop - start) // count
    firsts = [int(start) + i * length for i in range(count)]
    return list(zip(firsts, [*firsts[1:], int(stop)], strict=True))
