r"""The open questions of a search, and how informative a new record would be about them.

Each open question is a contrast: two models that the data do not distinguish. Where a claim is
ambiguous, they are the augmented model and the one with the rival in place of the claimed effect,
refitted to all data; where the place of a term without a name is ambiguous, those with it at either
place. Where the verdict is not noise, they are the augmented model and the same model with one of
the effects that were nearest to a claim.

**How far models differ.** On a new record with the drive :math:`u` their predictions differ by
:math:`\delta`. The wrong model takes up a part of that by changing its parameters by
:math:`\theta`, as far as the old data, with the Gram matrix :math:`M = J^T J` of its sensitivities,
allow. The remaining difference, over the variance of the noise, is the noncentrality that
T-optimality [1]_ maximises, here for two records and to first order:

.. math:: \lambda = \sigma^{-2} \min_\theta \|\delta + J_u \theta\|^2 + \theta^T M \theta
   = \sigma^{-2} \bigl(\delta^T \delta
     - \delta^T J_u (M + J_u^T J_u)^{-1} J_u^T \delta\bigr) .

Either model may be the right one. The search rejects the wrong one where its error grows by
``min_improvement``, :math:`m`: where :math:`\lambda` is more than :math:`(1 - m)^{-2} - 1` times
the number of all samples. A model that contains the other one, as a resonance contains a lag, can
fit its response and is never rejected. All variants of an effect are used that fit about as well as
its best one; the design is for the smallest difference.

**Gain.** A record gives :math:`\frac{1}{2} \ln (1 + \lambda)` nats about a coefficient of
:math:`\delta` with unit variance, on average over which of the two models is right. The best signal
rejects the most wrong models, and of signals that reject equally many, it has the most nats.

**No contrast.** Then the record is for the parameters with the widest intervals relative to their
values, or, where no effect explains the residual, for all parameters: the most informative record
then excites what the recording has excited least. The gain is the difference of :math:`\frac{1}{2}
\ln \det` of their covariance without and with the record (D-optimality for a subset [2]_), all from
the same matrices.

References
----------
.. [1] Atkinson and Fedorov, *Biometrika*, 1975.
.. [2] Atkinson, Donev and Tobias, *Optimum Experimental Designs, with SAS*, 2007, chapter 10.
"""

from dataclasses import replace

import numpy as np

from ._black_box import effect_of
from ._candidates import Candidate, refitted, screened
from ._constants import FEW, NEGLIGIBLE, SEVERAL, USUAL
from ._effects import EFFECTS
from ._plausibility import is_plausible
from ._report_text import listed, number


class Fitted:
    """A fitted model, and the information of the data about its parameters.

    Parameters
    ----------
    tree : Tree
        Fitted to the records.
    records : sequence of RecordData
    """

    def __init__(self, tree, records):
        problem = tree.problem(records)
        blocks = problem.evaluate(problem.x0)
        self.gram = problem.total(blocks)[:-1, :-1]
        # additive disturbances continue as in the last record
        self._additive = problem.coefficients(blocks)[-1:]
        self._tree = replace(tree, input_history=())  # a new record begins at rest

    def problem(self, record):
        """Return the least-squares problem of a new record."""
        return self._tree.problem([record])

    def predict(self, record):
        """Return the response to a new record, (n_samples,)."""
        problem = self.problem(record)
        return problem.outputs(problem.operator, problem.disturbances, self._additive)[0]

    def misses(self, y, record):
        """Return the residual sum of squares on response y, after a refit to y and the old data."""
        problem = self.problem(replace(record, y=y))
        total = problem.total(problem.evaluate(problem.x0))
        if not np.isfinite(total).all():  # an overflow is no evidence against the model
            return 0.0
        taken = total[:-1, -1] @ _inverse(self.gram + total[:-1, :-1]) @ total[:-1, -1]
        return max(total[-1, -1] - taken, 0.0)


def _inverse(gram):
    """Return the inverse of a Gram matrix, large where the data give no information."""
    diagonal = np.diag(gram)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = gram * np.outer(scale, scale)
    # the ridge gives directions without information a large, finite variance
    return np.linalg.inv(scaled + 1e-10 * np.eye(len(gram))) * np.outer(scale, scale)


# ------------------------------------------------------------------------- open questions


def question_of(search):
    """Return the open question of a fitted search: an object that rates a new record.

    ``evaluate(record)`` returns an answer, ``score(answer)`` a tuple that is larger for better
    records and ends with the nats, ``describe(answer, n_samples)`` the answer in words.
    """
    pairs = list(_rivals(search)) or list(_places(search)) or list(_near_claims(search))
    return Contrasts(search, pairs) if pairs else Intervals(search)


def _rivals(search):
    """Yield each ambiguous claim, a rival of it, and the fitted models with either."""
    # both sides of a contrast include all variants that fit about as well: a record has to
    # distinguish each of them
    tree = search._structure
    for row in search.history_.itertuples():
        start = tree.without(row.effect) if row.ambiguous_with else tree
        with_effect = _with_effect(row.effect, start, search) if row.ambiguous_with else []
        for name in row.ambiguous_with:
            rivals = _with_effect(name, start, search)
            if rivals:
                yield row.effect, name, ([Fitted(tree, search._records), *with_effect], rivals)


def _places(search):
    """Yield two places of an unknown term, and the models with it at either place."""
    for place, tree, other, rival in search._undistinguished[:FEW]:
        yield place, other, tuple([Fitted(model, search._records)] for model in (tree, rival))


def _near_claims(search):
    """Yield the effects nearest to a claim, "none", and the models with and without them."""
    if search.verdict_ == "noise" or search.ranking_.empty:
        return
    tree = search._structure
    table = search.ranking_.sort_values(["error_after", "screen"], ascending=[True, False])
    table = table[(table["round"] == table["round"].max()) & ~table["effect"].isin(tree.effects)]
    # the fraction of the power that an effect would have to remove to be claimed
    least = 1.0 - (1.0 - search.min_improvement) ** 2
    for name in table["effect"][table["screen"] > least][:FEW]:
        with_effect = _with_effect(name, tree, search)
        if with_effect:
            yield name, "none", (with_effect, [Fitted(tree, search._records)])


def _with_effect(name, tree, search):
    """Return the fitted variants of one more effect that fit about as well as the best."""
    if name not in EFFECTS or name in tree.effects:
        return []
    effect, records = effect_of(search._driver, EFFECTS[name]), list(search._records)
    without = refitted(Candidate((), tree, np.inf, np.inf, 0, np.empty(0)), tree, records)
    starts = sorted(screened(effect, tree, records), key=lambda c: c.predicted_cost)[:SEVERAL]
    fits = [refitted(c, c.structure, records, USUAL) for c in starts]
    fits = [c for c in fits if is_plausible(effect.plausible, c, without, records, search.alpha)]
    fits.sort(key=lambda c: c.cost)
    factor = (1.0 - search.min_improvement) ** 2
    return [Fitted(c.structure, records) for c in fits if factor * c.cost <= fits[0].cost]


class Contrasts:
    """Pairs of models that the data do not distinguish: (name, name, (models, models))."""

    def __init__(self, search, pairs):
        self._pairs = pairs
        self._variance = _noise(search) ** 2
        self._n_old = len(search.response_)
        self._share = (1.0 - search.min_improvement) ** -2 - 1.0

    def evaluate(self, record):
        """Return the noncentralities, (n_pairs, 2), and whether each rejects the wrong model.

        Column 0 is for the case that the first model of a pair is right.
        """
        values = []
        for _, _, sides in self._pairs:
            responses = [models[0].predict(record) for models in sides]
            contests = zip(responses, sides[::-1], strict=True)
            values.append(
                [min(m.misses(response, record) for m in models) for response, models in contests]
            )
        values = np.array(values) / self._variance
        return values, values > self._share * (self._n_old + len(record.u))

    def score(self, answer):
        """Return the number of wrong models that are rejected, and the mean nats."""
        noncentralities, rejected = answer
        return np.count_nonzero(rejected), 0.25 * np.log1p(noncentralities).sum()

    def describe(self, answer, n_samples):
        """Say which models are distinguished, and by how much."""
        forms = {2: "{0} from {1}", 1: "{0} from {1} if it is {2}", 0: "{0} from {1}"}
        texts = {False: [], True: []}
        for (*names, _), noncentralities, rejected in zip(self._pairs, *answer, strict=True):
            count = np.count_nonzero(rejected)
            decisive = noncentralities[rejected].min() if count else noncentralities.max()
            form = forms[count].format(*names, names[int(np.argmax(noncentralities))])
            size = number(np.sqrt(decisive / n_samples), 2)
            texts[count > 0].append(f"{form} ({size} times the noise)")
        parts = [f"it distinguishes {listed(texts[True])}"] if texts[True] else []
        parts += [f"it hardly distinguishes {listed(texts[False])}"] if texts[False] else []
        return f"{', but '.join(parts)}. The numbers are the RMS of their difference after a refit."


class Intervals:
    """The parameters with the widest confidence intervals relative to their values.

    A record is rated by how much it narrows them; where no effect explains the residual, by how
    much it narrows those of all parameters.
    """

    def __init__(self, search):
        tree = search._structure
        problem = tree.problem(search._records)
        self._model, self._variance = Fitted(tree, search._records), _noise(search) ** 2
        x, self._names = problem.x0, problem.names
        # a parameter at a bound has no interval
        self._inner = np.flatnonzero((x > problem.lower) & (x < problem.upper))
        covariance = self._covariance(self._model.gram)
        # an error of a logarithm is relative already; a signed parameter near zero has no relative
        # error
        signed = ~problem.log & (problem.lower < 0.0) & (problem.upper > 0.0)
        values = np.where(problem.log, 1.0, np.abs(x))[self._inner]
        has_relative_error = (values > np.sqrt(np.diag(covariance))) | ~signed[self._inner]
        self._values = np.where(has_relative_error & (values > 0.0), values, np.inf)
        order = np.argsort(-self._widths(covariance))
        self._widest = order[: min(FEW, np.count_nonzero(np.isfinite(self._values)))]
        self._is_open = search.verdict_ != "noise"
        self._rated = order if self._is_open else self._widest

    def _covariance(self, gram):
        return self._variance * _inverse(gram[np.ix_(self._inner, self._inner)])

    def _widths(self, covariance):
        return np.sqrt(np.diag(covariance)) / self._values

    def evaluate(self, record):
        """Return the covariance of the parameters without and with a record."""
        problem = self._model.problem(record)
        new = problem.total(problem.evaluate(problem.x0))[:-1, :-1]
        new = new if np.isfinite(new).all() else np.zeros_like(new)
        return [self._covariance(gram) for gram in (self._model.gram, self._model.gram + new)]

    def score(self, answer):
        """Return the nats as a tuple."""
        rated = np.ix_(self._rated, self._rated)
        before, after = (np.linalg.slogdet(covariance[rated])[1] for covariance in answer)
        return (0.5 * (before - after),)

    def describe(self, answer, n_samples):
        """Say which intervals become narrower, and by how much."""
        lead = "no effect is near to a claim" if self._is_open else "nothing is ambiguous"
        if not len(self._widest):
            return f"{lead}, and no parameter has a confidence interval."
        before, after = (100.0 * self._widths(covariance)[self._widest] for covariance in answer)
        narrower = listed(
            f"{_in_words(self._names[self._inner[i]])} (from ±{number(a, 2)} to ±{number(b, 2)} %)"
            for i, a, b in zip(self._widest, before, after, strict=True)
        )
        return f"{lead}; it narrows the widest confidence intervals: {narrower}."


def _in_words(name):
    """Return the name of a parameter in words.

    Examples
    --------
    >>> _in_words("prandtl_ishlinskii__weights[9]"), _in_words("gain")
    ('weights 10 of prandtl_ishlinskii', 'gain')
    """
    *stages, entry = name.split("__")
    entry, _, index = entry.rstrip("]").partition("[")
    entry = entry.replace("_", " ") + (f" {int(index) + 1}" if index else "")
    return " of ".join([entry, *reversed(stages)])


def _noise(search):
    return max(search.noise_model_.standard_deviation, NEGLIGIBLE * np.ptp(search.response_))
