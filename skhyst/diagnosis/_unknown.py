r"""A term without a name, for a residual that no effect explains.

It is sought after a verdict other than ``noise``. A smooth function of one signal, of unknown form
(:class:`~skhyst.static.UnknownTerm`), is tried at every place of the model: at each joint of the
series, as a function of one feature of the signal there: its value, its rate, a play of it, or the
time since it has turned; at the same joint as a function of such a feature of the input of the
stage before, or of the memory of a Bouc-Wen hysteresis there; as a force in the equation of motion
of linear dynamics, as a function of the displacement or the velocity
(:class:`~skhyst.compose.Feedback`); as a parameter that depends on a signal: the gain at a joint,
the stiffness or the damping; added to the drive, as a function of a feature of a further column of
X; and added to the response, as a function of a feature of the drive or of such a column. At each
place the functions are restricted to those that the model's parameters cannot reproduce; restricted
maximum likelihood chooses their smoothness. One evaluation of the model with all splines predicts
by how much each function reduces the error (partial residuals); the promising ones are refitted
jointly with the whole model and held out. What is missing may have led the parameters of the model
far away, so if structure may remain, the promising ones are refitted from the starts of the model
itself, too. The term of least held-out error is tested against the
model without it by the criterion of the search, corrected for all that the search and this step
have tried. Terms that the criterion does not distinguish from it are ``ambiguous_with``. If
structure may remain, a second term is sought in the same way, of functions that neither the
parameters nor the first term can reproduce. The model is then the sum of two smooth functions, and
the first is tested again with the second in the model (a forward and backward selection of groups
of functions). The alternative to this sum is a surface, a function of two features of a signal,
such as the product of a drive and its rate. A surface replaces a sum that it contains only where it
is better by the criterion, and any other sum where its held-out error is smaller. Whether a black
box calls noise what the first term leaves or not, it is tested against the surfaces that contain
it. A term whose fit is significantly worse than what another one predicts is not held out.

**The band.** Let C be the covariance of the weights in the joint fit under coloured noise, plus
that of the bias of the penalty: under the prior that the penalty represents, the weights have a
covariance, of which the penalty removes a known part (Nychka, *Journal of the American Statistical
Association*, 1988). The curve :math:`F w` at the points of a grid lies within :math:`\pm q \, (F C
F')_{ii}^{1/2}` at all points with 95 % probability: q is the quantile of :math:`\max_i |(F z)_i| /
(F C F')_{ii}^{1/2}`, with z normal of the covariance C. The selection of place and smoothness is
not included; its influence is small, see ``benchmarks/unknown_term.py``.

**Laws.** A law :math:`c \, g(v / s)` is the same term with a single function. Its scale s minimises
the predicted sum of squares; it is refitted and held out like any candidate. Laws of a surface are
products of two laws without a scale. Laws are listed if the free curve is not better by the same
criterion at the same level, those with fewest parameters and least error first.
"""

from dataclasses import dataclass, field, replace
from itertools import compress, product
from typing import Any

import numpy as np
import pandas as pd
from joblib import delayed
from scipy.ndimage import maximum_filter
from scipy.optimize import minimize_scalar
from sklearn.base import clone

from ..compose import Feedback
from ..operators import has_velocity
from ..optimize import (
    coloured_covariance,
    damped_step,
    penalised_covariance,
    predicted_cost,
)
from ..static import ARGUMENTS, UnknownTerm, UnknownTermOperator, smooth
from ._candidates import Candidate, completed, fitted, held_out
from ._changes import moves
from ._constants import RUNG, SETTLING, USUAL, WORSE
from ._edits import AddForce, BehindMemory, Bias, Drive, Enrich, InsertAt
from ._jobs import side_by_side
from ._pictures import Picture
from ._shortened import are_long
from ._starts import Scene, driven_starts
from ._traits import elastic_and_memory

NAME, SECOND = "unknown_term", "second_unknown_term"
_HALF_GAPS = (0.03, 0.1, 0.3)  # of plays, relative to the range of their input
_MAX_EVALUATIONS = 12  # of the predicted cost, for a scale or a half gap
_LAW_INTERVALS = {1: 200, 2: 40}  # of a law's splines: the resolution of its corners
_GRID_POINTS = {1: 101, 2: 25}  # points of a curve, and of each side of a surface
_DRAWS = 2000  # of the simultaneous band: its quantile is then known to about 1 %
_BAND_LEVEL = 0.95
_SHOWN_QUANTILES = (0.005, 0.995)  # of the argument, between which the curve is shown
LAW_COLUMNS = ["law", "formula", "c", "c_std", "s", "error", "p_value"]
_ENDS = ("drive", "response")  # places that are no stage's
_PARAMETERS = ("gain", "stiffness", "damping")
_SCALES = np.geomspace(0.03, 1.0, 12)  # of laws, relative to the largest argument

# name -> formula, function of the argument over its scale, and whether it has a scale
LAWS = {
    "proportional": ("c v", lambda v: v, False),
    "square": ("c v^2", np.square, False),
    "cube": ("c v^3", lambda v: v**3, False),
    "quadratic with sign": ("c |v| v", lambda v: np.abs(v) * v, False),
    "absolute value": ("c |v|", np.abs, False),
    "sign": ("c sign(v)", np.sign, False),
    "saturation": ("c max(-s, min(v, s)) / s", lambda v: np.clip(v, -1.0, 1.0), True),
    "smooth saturation": ("c tanh(v / s)", np.tanh, True),
    "dead band": (
        "c (v - max(-s, min(v, s))) / s",
        lambda v: v - np.clip(v, -1.0, 1.0),
        True,
    ),
    "Stribeck": ("c sign(v) exp(-|v| / s)", lambda v: np.sign(v) * np.exp(-np.abs(v)), True),
    "exponential": ("c (exp(v / s) - 1)", lambda v: np.expm1(np.clip(v, None, 30.0)), True),
    "notch": ("c exp(-(v / s)^2)", lambda v: np.exp(-np.square(v)), True),
}

# factors of the laws of surfaces, in the order of their numbers
_FACTORS = ["proportional", "square", "cube", "quadratic with sign", "absolute value", "sign"]


def _product(first, second):
    (first_formula, f, _), (second_formula, g, _) = LAWS[first], LAWS[second]
    formula = f"{first_formula} {second_formula.removeprefix('c ').replace('v', 'w')}"
    return formula, lambda v, w: f(v) * g(w), False


PRODUCTS = {f"{a} times {b}": _product(a, b) for a, b in product(_FACTORS, repeat=2)}


@dataclass(frozen=True)
class Site:
    """A place and an argument of a term.

    Attributes
    ----------
    place, argument, second : str
        Description in words; ``second`` is "" if there is one argument. The place of a parameter
        is that where it stands, such as the drive of a gain.
    model : UnknownTerm
    make : callable
        Returns the edit that inserts the model with an operator. Its ``part(tree)`` is the operator
        in a tree, ``owns_entry(name, tree)`` says whether an entry belongs to it, and
        ``unit(tree)`` is the unit of the argument.
    tree : Tree
        The model without the term, at which it is linearised.
    records : list of RecordData
        Driven by the argument's signal.
    parameter : str
        ``"gain"``, ``"stiffness"`` or ``"damping"`` if that depends on the argument, else "".
    scales : str
        The signal that this parameter multiplies, else "".
    """

    place: str
    argument: str
    model: Any
    make: Any
    tree: Any = field(repr=False)
    records: list = field(repr=False)
    second: str = ""
    parameter: str = ""
    scales: str = ""

    def __str__(self):
        return f"{self.where}: a function of the {_joined(self.argument, self.second)}"

    @property
    def where(self):
        """The place in words, with the parameter that depends on the argument."""
        if not self.parameter:
            return self.place
        place = self.place.removeprefix("motion ")
        return f"{self.parameter} {f'of the {place}' if place in _ENDS else place}"

    def signals(self):
        """Return the place with each signal that the term is a function of."""
        signals = self.argument, self.second, self.scales
        return [(self.place, signal) for signal in signals if signal]

    def with_term(self, operator, model=None):
        """Return the tree with an operator of the term, of the site's model or another."""
        edit = self.make(self.model if model is None else model, operator)
        return self.tree.edited(self.make.name, edit)

    def free_arguments(self, term):
        """Return the values of a term's free arguments, (n_samples, n_free)."""
        return self.arguments(term)[:, term.free]

    def arguments(self, term):
        """Return the values of all arguments of a term, (n_samples, n_arguments)."""
        values = np.concatenate([term.arguments(r.u, r.dt)[0] for r in self.records])
        return values.reshape(-1, len(term.names))

    def of(self, tree, records):
        """Return the same site of a tree with the same stages at other values."""
        sites = _sites(Scene(tree, records), 1 + bool(self.second))
        return replace(next(site for site in sites if str(site) == str(self)), model=self.model)

    def weight_indices(self, names, tree):
        """Return the indices of those of the named entries that are weights of the term."""
        return [
            i
            for i, name in enumerate(names)
            if self.make.owns_entry(name, tree) and name.split("__")[-1].startswith("weights")
        ]


@dataclass(frozen=True)
class Unknown:
    """A term without a name that a model lacks.

    Parameters
    ----------
    place : str
        Where its output is added: ``"drive"``, ``"behind <stage>"`` or ``"response"``; or ``"motion
        of <stage>"``, where it is a force that acts against that of the drive in the equation of
        motion. Of a parameter that depends on a signal ``"gain of the drive"``, ``"gain behind
        <stage>"``, ``"gain of the response"``, ``"stiffness of <stage>"`` or ``"damping of
        <stage>"``.
    argument : str
        What it is a function of, such as ``"rate of the drive"`` or ``"memory of <stage>"``, the
        hysteretic part of its output; for a force ``"displacement"`` or
        ``"velocity"``, from rest, in the direction of the drive.
    curve : DataFrame
        The function over the observed range of its argument: ``argument`` (in its own units, those
        of the stage's output for a displacement, rates per s), ``value``, ``low`` and ``high``, the
        simultaneous 95 % band, all in the units of the place (for a force, those of the stage's
        input; for a change of a gain or a stiffness, relative to that of the model, for one of a
        damping, s), and ``density``, the fraction of samples nearby. Components that the model's
        parameters can reproduce are left to them, such as the linear part in the drive to a gain,
        or in the velocity to a damping ratio. A surface has a column ``second``, too, and rows near
        samples only.
    error_before, error_after : float
        Held-out errors, units of the response.
    share : float
        Fraction of the power of the held-out residual that it explains.
    p_value : float
        Against the model without it, corrected for all that was tried. If no function of one
        signal is significant, but a surface that contains it is, that of the surface.
    ambiguous_with : tuple of str
        Places and arguments that the recording does not distinguish from it;
        :func:`next_experiment` proposes a drive that does.
    laws : DataFrame
        Laws that the curve is not better than: ``law``, ``formula``, ``c`` and ``c_std``, the scale
        ``s`` (NaN for a law without one), ``error``, and ``p_value`` against it, simplest first.
    structure_left : bool
        Whether the residual with the term is not judged to be noise: then the place may be another.
    noise_ceiling : float
        ``error_after``, or the part of it that a black box does not predict from the drive, the
        response of the model with the term, and the past of both.
    estimator : estimator
        The augmented model with the term, fitted to all data.
    second : Unknown or None
        A second term in addition to the first, if structure may remain: of another argument or at
        another place, tested like the first, against the model with the first. It contains no
        function that the first can reproduce (no concurvity): if two arguments move together, there
        is no second term. After a first term of the drive at the response, it is sought at the
        response only.
    second_argument : str, default=""
        Of a surface, called `w` in the formulas, as the argument is `v`.

    Examples
    --------
    Of a fitted search that ended without a name::

        if search.unknown_ is not None:
            print(search.unknown_)
            y = search.unknown_.estimator.predict(X)
    """

    place: str
    argument: str
    curve: pd.DataFrame
    error_before: float
    error_after: float
    share: float
    p_value: float
    ambiguous_with: tuple
    laws: pd.DataFrame
    structure_left: bool
    noise_ceiling: float
    estimator: Any
    second: "Unknown | None" = None
    second_argument: str = ""

    def __str__(self):
        """Return a description in one sentence."""
        arguments = _joined(self.argument, self.second_argument)
        text = f"a {self._added} that depends on the {arguments}, {self.shape}"
        if len(self.laws):
            first = self.laws.iloc[0]
            text += f", such as {first['formula']}"
        text += f"; it explains {100.0 * self.share:.0f} % of the power of the residual"
        if self.ambiguous_with:
            text += (
                f"; the recording does not distinguish it from {', or '.join(self.ambiguous_with)}"
            )
        if self.second is not None:
            return f"{text}; in addition, {self.second}"
        if self.structure_left:
            text += "; the residual with it need not be noise, so its place is uncertain"
        return text

    @property
    def code(self):
        """Line of code that registers the simplest law as an effect for later searches, or ""."""
        if not len(self.laws):
            return ""
        law, place = self.laws.iloc[0], self.place
        if not place.startswith("gain"):
            place = place.split(" of ")[0]  # of any stage
        arguments = [arg for arg in (self.argument, self.second_argument) if arg]
        name = "_".join([*law["law"].lower().split(), "of", *" and ".join(arguments).split()])
        variant = f"LawAt({', '.join(map(repr, (law['law'], place, *arguments)))})"
        letters = " and ".join(f"{v} the {arg}" for v, arg in zip("vw", arguments, strict=False))
        text = f"A {self._added}: {letters}, f = {law['formula']}."
        experiment = f"Move the {_joined(self.argument, self.second_argument)} through the range."
        return f"register_effect(Effect({name!r}, lambda: [{variant}], {text!r}, {experiment!r}))"

    @property
    def _added(self):
        if self.place.split()[0] in _PARAMETERS:
            return f"change of the {self.place}"
        if self.place.startswith("motion"):
            return f"force in the equation of {self.place}"
        return f"term added {'' if self.place.startswith('behind') else 'to the '}{self.place}"

    @property
    def shape(self):
        """Whether the curve is odd or even, within its band, and whether it rises or falls.

        For a surface, the fraction of its power that no sum of two functions reproduces.
        """
        if self.second_argument:
            return f"{100.0 * self._joint():.0f} % of it beyond a sum of two functions"
        x, f = self.curve["argument"].to_numpy(), self.curve["value"].to_numpy()
        half_band = 0.5 * (self.curve["high"] - self.curve["low"]).to_numpy()
        common, words = min(-x[0], x[-1]), []  # range of both signs
        if common > 0.5 * max(-x[0], x[-1]):
            size = np.linspace(0.0, common, len(x))
            f_plus, f_minus = np.interp(size, x, f), np.interp(-size, x, f)
            band = np.interp(size, x, half_band) + np.interp(-size, x, half_band)
            # deviations from an odd function about its value at zero, and from an even one
            deviations = {"odd": f_plus + f_minus - 2.0 * np.interp(0.0, x, f)}
            deviations["even"] = f_plus - f_minus
            words = [name for name, d in deviations.items() if np.all(np.abs(d) <= band)]
            words = words if len(words) == 1 else []  # a band around zero excludes neither
        slopes = np.diff(f)
        if np.all(slopes >= 0.0) or np.all(slopes <= 0.0):
            words.append("rising" if slopes.sum() > 0.0 else "falling")
        return ", ".join(words) if len(words) else "neither odd nor even"

    def _joint(self):
        """Return the fraction of a surface's power that no sum of two functions reproduces."""
        indicators = [pd.get_dummies(self.curve[name]) for name in ("argument", "second")]
        root, value = np.sqrt(self.curve["density"].to_numpy()), self.curve["value"].to_numpy()
        columns = root[:, None] * np.hstack([one.to_numpy(dtype=float) for one in indicators])
        residual = root * value - columns @ np.linalg.lstsq(columns, root * value, rcond=None)[0]
        deviation = root * (value - np.average(value, weights=np.square(root)))
        return float(residual @ residual / (deviation @ deviation or 1.0))

    def picture(self):
        """Return the curve with its band, or the contours of a surface, and the data's density.

        Returns
        -------
        Picture
        """
        if self.second_argument:
            grid = self.curve.pivot(index="second", columns="argument")
            values, density = (grid[name].to_numpy() for name in ("value", "density"))
            surface = grid["value"].columns.to_numpy(), grid.index.to_numpy(), values, density
            title = f"Unexplained: {self._added}"
            return Picture(title, self.argument, self.second_argument, (), surface=surface)
        x, f, low, high, density = self.curve.to_numpy().T
        band = ("95 % band", x, low, "dashed"), ("", x, high, "dashed")
        curves = ("curve", x, f, "line"), *band
        below = Picture("", self.argument, "samples (%)", (("", x, 100.0 * density, "line"),))
        added = self._added.removeprefix("term ").split(" in the equation")[0]
        return Picture("Unexplained", self.argument, added, curves, below=below)

    def to_dict(self):
        """Return the term as plain data.

        Returns
        -------
        dict
            Without the estimator.
        """
        names = ["place", "argument", "second_argument", "error_before", "error_after", "share"]
        names += ["p_value", "structure_left", "noise_ceiling", "shape", "code"]
        content = {name: getattr(self, name) for name in names} | {"text": str(self)}
        content["ambiguous_with"] = list(self.ambiguous_with)
        content["second"] = None if self.second is None else self.second.to_dict()
        content["curve"] = {name: values.tolist() for name, values in self.curve.items()}
        return content | {"laws": self.laws.to_dict("records")}


def find_unknown(base, data, criterion, n_tried, n_jobs, judgement):
    """Return the terms without a name that a candidate lacks.

    Parameters
    ----------
    base : Candidate
    data : tuple
        Records, slices and folds.
    criterion : Criterion
    n_tried, n_jobs : int
    judgement : callable
        Of a candidate, that of its residual.

    Returns
    -------
    list of Term
        None, one, or two whose sum is meant.
    """
    setting = data, criterion
    first, before, functions = _best_term(base, *setting, n_tried, n_jobs, judgement=judgement)
    if first is not None:
        base = replace(base, structure=first.site.tree)
    signals = set() if first is None else set(first.site.signals())
    surface, n_tried, _ = _best_term(base, *setting, before, n_jobs, 2, signals.issubset)
    if first is None:
        return [] if surface is None else [_simplest(surface, functions, criterion)]
    known, n_surfaces = first.candidate, n_tried - before
    if surface is None or not _is_more(known, surface.candidate, criterion, n_surfaces):
        if judgement(known).verdict == "noise":
            return [first]
        other, n_tried, _ = _best_term(
            base, *setting, n_tried, n_jobs, 2, lambda read: not signals.issubset(read)
        )
        surfaces = filter(None, (surface, other))
        surface = min(surfaces, key=lambda term: term.candidate.error, default=None)
    second, *_ = _best_term(known, *setting, n_tried, n_jobs, alternative=surface)
    terms = [first] if second is None else _needed(first, second, *setting, n_tried)
    if surface is None:
        return terms
    alternatives, sum_candidate = [terms, [surface]], terms[-1].candidate
    if {s for term in terms for s in term.site.signals()} <= set(surface.site.signals()):
        is_surface = _is_more(sum_candidate, surface.candidate, criterion)
    else:
        is_surface = surface.candidate.error < sum_candidate.error
    chosen, rejected = alternatives[is_surface], alternatives[not is_surface]
    if criterion.p_value(rejected[-1].candidate, chosen[-1].candidate) < criterion.alpha:
        return chosen
    rival = ", and ".join(str(term.site) for term in rejected), rejected[-1].candidate
    return [replace(chosen[0], ambiguous=[*chosen[0].ambiguous, rival]), *chosen[1:]]


def _is_more(part, whole, criterion, n_tried=1):
    """Whether a candidate that contains another one fits noticeably better, and predicts better.

    Splines of one argument may predict worse only because they are finer, where few samples are.
    """
    fits_better = whole.cost < (1.0 - criterion.min_improvement) ** 2 * part.cost
    return fits_better and criterion.is_better(part, whole, n_tried)


def _simplest(surface, functions, criterion):
    """Return a surface, or the best function that it contains and is no noticeable improvement on.

    Where a function of one signal alone is not significant, the surface is the evidence.
    """
    signals, whole = set(surface.site.signals()), surface.candidate
    parts = [(s, c) for s, c in functions if signals.issuperset(s.signals())]
    parts = [(s, c) for s, c in parts if not _is_more(c, whole, criterion)]
    if not parts:
        return surface
    site, best = min(parts, key=lambda pair: pair[1].error)
    others = [(str(surface.site), whole), *surface.ambiguous]
    others += [(str(s), c) for s, c in parts if c is not best]
    rivals = [(name, c) for name, c in others if criterion.p_value(c, best) >= criterion.alpha]
    return replace(surface, site=site, candidate=best, ambiguous=rivals)


def _needed(first, second, data, criterion, n_tried):
    """Return those of two terms that are needed; the first may only have imitated the second."""
    records, _, folds = data
    tree, base = second.candidate.structure.without(NAME), first.base
    alone = completed(_candidate(tree, records), records, _budget(records))
    alone = held_out(alone, records, folds)
    if criterion.is_better(alone, second.candidate, 1):
        return [first, second]
    if not criterion.is_better(base, alone, n_tried):
        return [first]
    p_value = criterion.p_value(base, alone, n_tried)
    site = replace(second.site, tree=base.structure)
    return [Term(site, alone, base, p_value, [])]


@dataclass(frozen=True)
class Term:
    """A term that was found at a site.

    Attributes
    ----------
    site : Site
    candidate, base : Candidate
        With and without the term.
    p_value : float
    ambiguous : list of (str, Candidate)
        Places and arguments that are not distinguished from it.
    """

    site: Site
    candidate: Candidate
    base: Candidate
    p_value: float
    ambiguous: list


def _best_term(
    base,
    data,
    criterion,
    n_tried,
    n_jobs,
    n_arguments=1,
    wanted=lambda signals: True,
    alternative=None,
    judgement=None,
):
    """Return the best significant term of so many arguments, or None, and the number of trials.

    And the sites and candidates that were held out.

    It is a function of ``wanted`` signals, and competes with an ``alternative`` term. From cheap to
    dear: predicted cost of all, joint fits of the promising, half gaps of plays near the best, and
    held-out errors of those whose fit is not significantly worse than what the best of them
    predicts. With a ``judgement``, if that leaves structure, those near the best start again from
    the starts of the model itself: what is missing may have led its parameters far away.
    """
    records = data[0]
    scene = Scene(base.structure, records)
    sites = [site for site in _sites(scene, n_arguments) if wanted(set(site.signals()))]
    jobs = [delayed(_started)(site, records) for site in sites]
    starts, _ = side_by_side(jobs, 1)
    starts = [candidates or [] for candidates in starts]
    n_trials = n_tried + sum(map(len, starts))
    largest_cost = (1.0 - criterion.min_improvement) ** 2 * base.cost
    promising = [
        (site, min(candidates, key=lambda c: c.predicted_cost))
        for site, candidates in zip(sites, starts, strict=True)
        if candidates
    ]
    promising = [(site, c) for site, c in promising if c.predicted_cost < largest_cost]
    n_trials += _MAX_EVALUATIONS * sum(_follows_play(site.model) for site, _ in promising)
    known = [] if alternative is None else [alternative.candidate]
    settled, near = _compared(promising, known, largest_cost, data, criterion, n_jobs)
    best = min((c for _, c in settled), key=lambda c: c.error, default=None)
    if judgement and best is not None and judgement(best).verdict != "noise":
        trees = _at_other_starts(scene)
        jobs = [delayed(_started_again)(site, c, trees, records) for site, c in near]
        again = list(filter(None, side_by_side(jobs, n_jobs)[0]))
        n_trials += len(trees) * len(near)
        known = [c for _, c in settled]
        settled += _compared(again, known, min(c.cost for c in known), data, criterion, n_jobs)[0]
    better = [(s, c) for s, c in settled if criterion.is_better(base, c, n_trials)]
    if not better:
        return None, n_trials, settled
    site, best = min(better, key=lambda pair: pair[1].error)
    rivals = [(str(s), c) for s, c in better if str(s) != str(site)]
    rivals = [(name, c) for name, c in rivals if criterion.p_value(c, best) >= criterion.alpha]
    p_value = criterion.p_value(base, best, n_trials)
    return Term(site, best, base, p_value, rivals), n_trials, settled


def _compared(promising, known, largest_cost, data, criterion, n_jobs):
    """Return sites and candidates that were held out, and those that were near the best fit.

    ``known`` candidates, and those that reach no less than the ``largest_cost``, are left out.
    """
    records, _, folds = data
    jobs = [delayed(completed)(c, records, _budget(records)) for _, c in promising]
    done, _ = side_by_side(jobs, n_jobs)
    largest_cost = min([largest_cost, *(WORSE * c.cost for c in (*done, *known) if c is not None)])
    is_near = [c is not None and c.cost < largest_cost for c in done]
    promising = list(compress(zip(done, promising, strict=True), is_near))
    jobs = [delayed(_with_gap)(c, site, start, records) for c, (site, start) in promising]
    done, _ = side_by_side(jobs, n_jobs)
    near = [(s, c) for (_, (s, _)), c in zip(promising, done, strict=True) if c is not None]
    settled, waiting = [], sorted(near, key=lambda pair: pair[1].cost)
    while waiting:
        if known:
            best = min(known, key=lambda c: c.error)
            is_next = [criterion.p_value(c, best) >= criterion.alpha for _, c in waiting]
        else:
            is_next = [True] + [False] * (len(waiting) - 1)
        jobs = [
            delayed(_settled)(c, site, records, folds) for site, c in compress(waiting, is_next)
        ]
        done = list(filter(None, side_by_side(jobs, n_jobs)[0]))
        settled, known = settled + done, known + [c for _, c in done]
        waiting = list(compress(waiting, np.logical_not(is_next))) if any(is_next) else []
    return settled, near


def _at_other_starts(scene):
    """Return the tree of a scene at the promising ones of the starts of its model."""
    tree, model = scene.tree, scene.tree.model
    operators = driven_starts(model, scene.records) + model.further_starts(scene.records)
    trees = [replace(tree, root=model.tree((o, tree.disturbances))) for o in operators]
    return scene.promising(trees, 0)


def _started_again(site, candidate, trees, records):
    """Return a site and its candidate at the best of other starting values, or None.

    The site is that of the tree as it is fitted jointly with the term from there.
    """
    if _follows_play(site.model):
        half_gap = site.make.part(candidate.structure).half_gap
        site = replace(site, model=clone(site.model).set_params(half_gap=half_gap))
    starts = [c for tree in trees for c in _started(site.of(tree, records), records)]
    if not starts:
        return None
    start = min(starts, key=lambda c: c.predicted_cost)
    found = completed(start, records, _budget(records))
    if not found.cost < candidate.cost:
        return None
    site = site.of(found.structure.without(site.make.name), records)
    starts = _started(site, records)
    return (site, starts[0]) if starts else None


def _sites(scene, n_arguments=1):
    """Yield all places and arguments of a model."""
    yield from _motions(scene, n_arguments)
    # the signal itself with one of the features computed from it
    pairs = [(ARGUMENTS[0], feature) for feature in ARGUMENTS[1:]]
    arguments = pairs if n_arguments == 2 else [(name,) for name in ARGUMENTS]
    tree, records, name = scene.tree, scene.records, _name(scene.tree)
    term = tree.label(NAME) if NAME in tree.effects else None
    last = len(tree.stages)
    for joint in range(int(tree.multi_input), last + 1):
        before = tree.names[joint - 1] if joint else None
        if before is not None and before == term:  # the joint before it is the same place
            continue
        is_response = all(name == term for name in tree.names[joint:])
        place = "response" if is_response else f"behind {before}" if joint else "drive"
        signal = f"output of {before}" if joint else "drive"
        make, driven = _Joint(before, name), scene.records_at(joint)
        for names in arguments:
            model = UnknownTerm(names[0], second=names[1] if names[1:] else None, passes=True)
            first, second = _in_words(names, signal)
            yield Site(place, first, model, make, tree, driven, second)
        for names in pairs if n_arguments == 1 else []:
            model = UnknownTerm(*names[:1], second=names[1], passes=True, linear_in="argument")
            multiplied, argument = _in_words(names, signal)
            yield Site(place, argument, model, make, tree, driven, "", "gain", multiplied)
    if n_arguments == 1:
        yield from _inner(scene, arguments, term)
    auxiliary = records[0].auxiliary
    for column in range(1 + (0 if auxiliary is None else auxiliary.shape[1])):
        driven = records
        if column:
            driven = [replace(r, u=r.auxiliary[:, column - 1], before=None) for r in records]
        signal = f"column {column} of X" if column else "drive"
        places = {"response": _Column(column, name)}
        if column and not tree.multi_input:
            places["drive"] = _Bias(column, name)
        for (place, make), names in product(places.items(), arguments):
            model = UnknownTerm(names[0], second=names[1] if names[1:] else None)
            first, second = _in_words(names, signal)
            yield Site(place, first, model, make, tree, driven, second)


def _inner(scene, arguments, term):
    """Yield the sites of functions of a stage's input or memory, added to its output."""
    tree, name = scene.tree, _name(scene.tree)
    for at, (stage_name, operator) in enumerate(tree.stages):
        if stage_name == term or (not at and tree.multi_input):
            continue
        is_last = all(name == term for name in tree.names[at + 1 :])
        place, driven = "response" if is_last else f"behind {stage_name}", scene.records_at(at)
        signal = f"output of {tree.names[at - 1]}" if at else "drive"
        make = _Within(AddForce, stage_name, name)
        # a function of the drive at the response is one of a column
        for names in arguments if at or not is_last else []:
            yield Site(place, _in_words(names, signal)[0], UnknownTerm(*names), make, tree, driven)
        elastic, memory = elastic_and_memory(operator) or (None, None)
        if not elastic:
            continue
        driven = [replace(r, u=memory.run(r.u, r.dt)[0], before=None) for r in driven]
        make, model = _Within(BehindMemory, stage_name, name), UnknownTerm(passes=True)
        yield Site(place, f"memory of {stage_name}", model, make, tree, driven)


def _name(tree):
    """Return the name of the next term without a name that a tree gets."""
    return SECOND if NAME in tree.effects else NAME


# forces in an equation of motion: argument of the `Feedback`, number of free arguments, parameters
# of the term, and the last entries of its `Site` in words: argument, second argument, parameter and
# the signal that it multiplies
_BOTH = {"second": "rate"}
_LINEAR_IN_X = _BOTH | {"linear_in": "argument"}
_LINEAR_IN_V = _BOTH | {"linear_in": "second"}
_FORCES = [
    ("displacement", 1, {}, ("displacement",)),
    ("velocity", 1, {}, ("velocity",)),
    ("both", 1, _LINEAR_IN_X, ("velocity", "", "stiffness", "displacement")),
    ("both", 1, _LINEAR_IN_V, ("displacement", "", "damping", "velocity")),
    ("both", 2, _BOTH, ("displacement", "velocity")),
]


def _motions(scene, n_arguments):
    """Yield the sites of forces in the equations of motion of linear dynamics."""
    for at, (stage_name, linear) in enumerate(scene.tree.stages):
        if not moves(linear):
            continue
        records = scene.records_at(at)
        for argument, n_free, options, words in _FORCES if has_velocity(linear) else _FORCES[:1]:
            if n_free != n_arguments:
                continue
            model = UnknownTerm(passes=argument != "velocity", **options)
            loop = Feedback(scene.tree.models[at], model, argument=argument)
            zeros = np.zeros(1), np.zeros((4 ** (1 + ("second" in options)), 1))
            term = UnknownTermOperator(*zeros, 0.0, 1.0, passed=float(model.passes), **options)
            closed_loop = loop.divided(linear, term, records)
            make = _Motion(stage_name, loop, closed_loop, _name(scene.tree))
            driven = make.driven(closed_loop, records)
            place = f"motion of {stage_name}"
            yield Site(place, words[0], model, make, scene.tree, driven, *words[1:])


def _in_words(names, signal):
    """Return the arguments in words, the second is "" where there is none."""
    words = {"input": signal, "turn": f"time since a turn of the {signal}"}
    first, *second = [words.get(name, f"{name} of the {signal}") for name in names]
    return first, *(second or [""])


def _joined(argument, second):
    return f"{argument} and the {second}" if second else argument


def _follows_play(model):
    return "play" in (model.argument, model.second)


class _Part:
    """Makes an edit that adds a term to a tree as a part with the name ``name``."""

    @staticmethod
    def unit(tree):
        """Return the unit of the argument: that of the signal."""
        return 1.0

    def part(self, tree):
        """Return the operator of the term."""
        label = tree.label(self.name)
        parts = [*tree.stages, *(tree.root.members() if hasattr(tree.root, "members") else [])]
        operator = next(part for name, part in parts if name == label)
        return getattr(operator, "operator", operator)

    def owns_entry(self, name, tree):
        """Whether an entry belongs to the term."""
        return tree.label(self.name) in name.split("__")


@dataclass(frozen=True)
class _Joint(_Part):
    """Makes the edit that inserts a term at a joint of the series."""

    behind: str | None
    name: str

    def __call__(self, model, operator):
        return InsertAt(self.behind, model, operator)


@dataclass(frozen=True)
class _Within(_Part):
    """Makes the edit of one stage, which then contains the term."""

    edit: type
    place: str
    name: str

    def __call__(self, model, operator):
        return self.edit(self.place, model, operator)

    def part(self, tree):
        label, inside = tree.label(self.name), [tree.operators[tree.names.index(self.place)]]
        while inside:
            operator = inside.pop()
            if hasattr(operator, "members"):
                inside += [part for name, part in operator.members() if name != label]
                found = [part for name, part in operator.members() if name == label]
                if found:
                    return found[0]
        raise KeyError(label)


@dataclass(frozen=True)
class _Motion:
    """Makes the edit that adds a force to the equation of motion of linear dynamics."""

    place: str
    loop: Any
    closed_loop: Any
    name: str

    def __call__(self, model, operator):
        stages = self.closed_loop.linear, operator
        return Enrich(self.place, self.loop, replace(self.closed_loop, stages=stages))

    def part(self, tree):
        return tree.operators[tree.names.index(self.place)].curve

    def owns_entry(self, name, tree):
        """Whether an entry belongs to the term; a single stage has no name in it."""
        parts = name.split("__")
        return parts[-2:-1] == ["curve"] and parts[-3:-2] in ([self.place], ["model"], [])

    def unit(self, tree):
        """Return the unit of the argument: the loop sees the motion before the gain."""
        return abs(tree.operators[tree.names.index(self.place)].linear.gain)

    @staticmethod
    def driven(loop, records):
        """Return records driven by the argument of a term in the loop, or the first of two."""
        return [replace(r, u=loop.arguments(r.u, r.dt)[:, 0], before=None) for r in records]

    def renewed(self, site, tree, records, independent):
        """Return the site and the tree with the argument's range and smoothness at a solution.

        The function at the solution is projected onto the splines of the new range; these are then
        restricted like those of a term at zero.
        """
        at = tree.names.index(self.place)
        loop, model = tree.operators[at], tree.models[at]
        site = replace(site, records=self.driven(loop, Scene(tree, records).records_at(at)))
        flexible = site.model.flexible(site.records)
        n_points = _LAW_INTERVALS[len(flexible.names)]
        points = _grid([np.linspace(*ends, n_points) for ends in flexible.ranges])
        values = loop.curve.functions(points) @ loop.curve.weights

        def with_loop(term):
            return tree.with_stage(at, model.tree(replace(loop, stages=(loop.linear, term))))

        def projected(term, density):
            root = np.sqrt(density.ravel())
            weights = np.linalg.lstsq(term.functions(points) * root[:, None], values * root)[0]
            return replace(term, weights=weights)

        flexible = projected(flexible, np.ones(len(points)))
        problem = with_loop(flexible).problem(records)
        gram = problem.total(problem.evaluate(problem.x0))
        columns = np.array(site.weight_indices(problem.names, tree))
        # target of the whole term: the residual plus the present contribution of the term
        gram[:, -1] -= gram[:, columns] @ flexible.weights
        gram[-1] -= flexible.weights @ gram[columns]
        term = smooth(flexible, gram, columns, problem.segment_weight.sum(), independent)
        return site, with_loop(projected(term, np.histogramdd(site.arguments(term), n_points)[0]))


@dataclass(frozen=True)
class _Column(_Part):
    """Makes the edit that adds a term of a column of X to the response."""

    column: int
    name: str

    def __call__(self, model, operator):
        return Drive(model, operator, self.column)


@dataclass(frozen=True)
class _Bias(_Part):
    """Makes the edit that adds a term of a column of X to the drive."""

    column: int
    name: str

    def __call__(self, model, operator):
        return Bias(model, operator, self.column, 0.0)

    def part(self, tree):
        operator = tree.operators[tree.names.index(tree.label(self.name))]
        return operator.stages[operator.names.index("column")].operator


def _models(site):
    """Return the models of a site; for a play one of each half gap that is tried first."""
    if not _follows_play(site.model) or site.model.half_gap is not None:
        return [site.model]
    span = max(float(np.ptp(r.u)) for r in site.records)
    return [clone(site.model).set_params(half_gap=fraction * span) for fraction in _HALF_GAPS]


def _started(site, records):
    """Return the candidates of a site at their starting values, with all weights zero."""
    found = []
    for model in _models(site):
        splines = _Splines.of(site, model, model.flexible(site.records), records)
        operator = splines.smoothed()
        if operator.weights.size:
            found.append(splines.candidate(operator))
    return found


@dataclass(frozen=True)
class _Splines:
    """A model with all splines of a term at zero; any function is a linear combination of them.

    One evaluation gives the Gram matrix of every such combination (partial residuals), and so the
    cost that each is predicted to reach.

    Attributes
    ----------
    site, model, operator
        Site, and model and operator of the term with all splines.
    records : list of RecordData
    gram : ndarray of shape (n_parameters + 1, n_parameters + 1)
        With the residual as the last column.
    columns : ndarray of shape (n_splines,)
        Indices of the splines' weights among the parameters.
    n_samples : float
        Sum of the samples' weights.
    """

    site: Site
    model: Any
    operator: Any
    records: list
    gram: np.ndarray
    columns: np.ndarray
    n_samples: float

    @classmethod
    def of(cls, site, model, operator, records):
        """Evaluate the site's tree with an operator that has all splines."""
        problem = site.with_term(operator, model).problem(records)
        gram = problem.total(problem.evaluate(problem.x0))
        columns = np.array(site.weight_indices(problem.names, site.tree))
        n_samples = problem.segment_weight.sum()
        return cls(site, model, operator, records, gram, columns, n_samples)

    def smoothed(self, independent=1.0):
        """Return the operator restricted to functions that the parameters cannot reproduce."""
        return smooth(self.operator, self.gram, self.columns, self.n_samples, independent)

    def candidate(self, operator, combined=None):
        """Return the candidate of an operator whose functions are combinations of the splines.

        ``combined`` has a column of coefficients for each of its functions; their weights are zero.
        """
        if combined is None:
            combined = np.linalg.lstsq(self.operator.basis, operator.basis, rcond=None)[0]
        tree = self.site.with_term(operator, self.model)
        problem = tree.problem(self.records)
        cost, size = self.cost(problem, combined), len(problem.x0) + tree.n_further_estimates()
        return Candidate(tree.effects[-1:], tree, np.inf, cost, size, problem.x0)

    def cost(self, problem, combined):
        """Return the predicted cost of such a candidate's problem."""
        columns = np.array(self.site.weight_indices(problem.names, self.site.tree))
        transform = np.zeros((len(self.gram), len(problem.x0) + 1))
        transform[np.ix_(self.columns, columns)] = combined
        # all other parameters, and the residual, are the same
        others = [
            np.setdiff1d(np.arange(size), of_term)
            for size, of_term in zip(transform.shape, (self.columns, columns), strict=True)
        ]
        transform[tuple(others)] = 1.0
        gram = transform.T @ self.gram @ transform
        gram[columns, columns] += self.n_samples * problem.penalty[columns]
        _, reduction = damped_step(problem, problem.x0, gram)
        return max(gram[-1, -1] - reduction, 0.0)


def _with_gap(candidate, site, start, records):
    """Return a candidate, that of a play with the half gap of least predicted cost.

    With the residuals of its fit, which are smaller than those of its settled form held out.
    """
    if _follows_play(site.model):
        tried, half_gap = [start], site.make.part(start.structure).half_gap

        def cost(log_gap):
            model = clone(site.model).set_params(half_gap=float(np.exp(log_gap)))
            started = _started(replace(site, model=model), records)
            tried.extend(started)
            return started[0].predicted_cost if started else np.inf

        spacing = 0.5 * np.log(_HALF_GAPS[-1] / _HALF_GAPS[0])  # of the half gaps tried first
        _minimizer(cost, np.log(half_gap) + np.array([-spacing, spacing]))
        best = min(tried, key=lambda c: c.predicted_cost)
        candidate = completed(best, records, _budget(records))
    _, residuals = fitted(candidate, records, [0] * len(records))
    return replace(candidate, residuals=tuple(residuals))


def _minimizer(cost, bounds):
    """Return where a function of a logarithm is least, to one percent."""
    options = {"xatol": 0.01, "maxiter": _MAX_EVALUATIONS}
    return minimize_scalar(cost, bounds=bounds, method="bounded", options=options).x


def _candidate(tree, records):
    """Return the candidate of a tree at its present values."""
    problem = tree.problem(records)
    cost = predicted_cost(problem, problem.x0)
    size = len(problem.x0) + tree.n_further_estimates()
    return Candidate(tree.effects[-1:], tree, np.inf, cost, size, problem.x0)


def _budget(records):
    return RUNG if are_long(records) else USUAL


def _settled(candidate, site, records, folds):
    """Return the site and the candidate, held out; None if the term vanishes.

    The smoothness depends on the noise, and a loop is not linear in its term: the required function
    and its argument are known only with the loop closed. So the smoothness is found again at the
    solution, until its effective number of functions changes by less than one.
    """
    for _ in range(SETTLING):
        tree = candidate.structure
        _, independent = _errors(site, tree, records)
        previous = site.make.part(tree)
        if isinstance(site.make, _Motion):
            site, tree = site.make.renewed(site, tree, records, independent)
        elif independent < 1.0:
            model = clone(site.model)
            if _follows_play(model):
                model.set_params(half_gap=previous.half_gap)
            flexible = model.flexible(site.records)
            operator = _Splines.of(site, model, flexible, records).smoothed(independent)
            tree = site.with_term(operator, model)
        renewed = site.make.part(tree)
        if not renewed.weights.size:
            return None
        if abs(renewed.effective_number - previous.effective_number) < 1.0:
            break
        candidate = completed(_candidate(tree, records), records, _budget(records))
    return site, held_out(candidate, records, folds)


def _errors(site, tree, records):
    """Return the covariance of the term's weights, and the independent fraction of samples."""
    problem = tree.problem(records)
    n, x = problem.segment_weight.sum(), problem.x0
    gram = problem.total(problem.evaluate(x))
    scale = np.sqrt(np.diag(gram)[:-1])
    scale[scale == 0.0] = 1.0
    eigenvalues, vectors = np.linalg.eigh(gram[:-1, :-1] / np.outer(scale, scale))
    # without directions that the data do not determine
    determined = eigenvalues > 1e-10 * eigenvalues.max()
    root = vectors[:, determined] / np.sqrt(eigenvalues[determined]) / scale[:, None]
    # the penalty is a part of the Gram matrix, of its last entry, too
    variance = (gram[-1, -1] - n * problem.penalty @ np.square(x)) / max(n - len(x), 1.0)
    columns = np.array(site.weight_indices(problem.names, tree))
    coloured = coloured_covariance(lambda: problem.rows(x), root, n)
    known = variance * root @ root.T, coloured, variance, columns
    covariance, independent = penalised_covariance(problem, *known)
    return covariance[np.ix_(columns, columns)], independent


def _table(term, law, scales):
    """Return a law's spline coefficients relative to the largest of them, and the largest."""
    # the value at a knot is the coefficient of a spline close to the function
    knots = [term.knots()[i] / scale for i, scale in zip(term.free, scales, strict=True)]
    table = law(*np.meshgrid(*knots, indexing="ij")).reshape(-1, 1)
    size = np.abs(table).max() or 1.0  # a dead band may be wider than the whole range
    return table / size, size


def _fine(term):
    """Return an operator with splines that are fine enough for the corners of a law."""
    n_splines = (_LAW_INTERVALS[len(term.names)] + 3) ** len(term.names)
    return replace(term, weights=np.zeros(1), basis=np.zeros((n_splines, 1)), penalty=0.0)


def _with_functions(term, table):
    """Return an operator with the functions of a table of spline coefficients, at zero weights."""
    return replace(term, weights=np.zeros(table.shape[1]), basis=term.spread(table))


@dataclass(frozen=True)
class LawAt:
    """A law at a place of a model: a variant of an effect of your own, see :class:`Effect`.

    Parameters
    ----------
    law : str
        ``"proportional"``, ``"square"``, ``"cube"``, ``"quadratic with sign"``, ``"absolute
        value"``, ``"sign"``, ``"saturation"``, ``"smooth saturation"``, ``"dead band"``,
        ``"Stribeck"``, ``"exponential"`` or ``"notch"``; of two arguments two of the first six,
        such as ``"proportional times sign"``.
    place, argument : str
        As :class:`Unknown` has them; the place of a force is ``"motion"``, of any stage, as
        ``"stiffness"``, ``"damping"`` and ``"gain"`` are of any.
    second_argument : str, default=""
        As :class:`Unknown` has it.

    Raises
    ------
    ValueError
        If there is no such law.

    Examples
    --------
    >>> from skhyst.diagnosis import Effect, LawAt, register_effect, unregister_effect
    >>> drag = lambda: [LawAt("quadratic with sign", "motion", "velocity")]
    >>> register_effect(Effect("drag", drag, "Turbulent flow resists.", "Let it ring down."))
    >>> unregister_effect("drag")
    """

    law: str
    place: str
    argument: str
    second_argument: str = ""

    def __post_init__(self):
        laws = _laws_of(self.second_argument)
        if self.law not in laws:
            names = ", ".join(map(repr, laws))
            raise ValueError(
                f"The 'law' parameter of LawAt must be one of {names}. Got {self.law!r} instead."
            )

    def trees(self, name, scene):
        """Return the trees with the law, at starting values.

        Parameters
        ----------
        name : str
            Name of the effect.
        scene : Scene
            The current model and its records.

        Returns
        -------
        list of Tree
            Empty if the model has no such place.
        """
        _, law, has_scale = _laws_of(self.second_argument)[self.law]
        trees = []
        for site in _sites(scene, 1 + bool(self.second_argument)):
            places = {site.where, site.where.split(" of ")[0]}
            arguments = self.argument, self.second_argument
            if self.place not in places or (site.argument, site.second) != arguments:
                continue
            for model in _models(site):
                term = _fine(model.flexible(site.records))
                largest = _largest(site, term)
                for scale in _SCALES if has_scale and np.all(largest) else [1.0]:
                    table, _ = _table(term, law, scale * np.where(largest, largest, 1.0))
                    edit = site.make(model, _with_functions(term, table))
                    trees.append(scene.tree.edited(name, edit))
        return trees


def _laws_of(second):
    """Return the laws of one argument, or of two."""
    return PRODUCTS if second else LAWS


def _largest(site, term):
    """Return the largest size of each free argument, (n_free,)."""
    return np.abs(site.free_arguments(term)).max(axis=0)


def laws_of(term, data, criterion):
    """Return laws that the function is not better than, as rows of ``Unknown.laws``."""
    (records, slices, folds), site, free, base = data, term.site, term.candidate, term.base
    operator, rows = _fine(site.make.part(free.structure)), []
    largest = _largest(site, operator)
    if not np.all(largest > 0.0):
        return []
    laws = _laws_of(site.second)
    if site.second:  # laws of two arguments have no scale: one function for each is enough
        functions = np.hstack([_table(operator, law, largest)[0] for _, law, _ in laws.values()])
    else:
        functions = np.eye(_LAW_INTERVALS[len(operator.names)] + 3)
    splines = _Splines.of(site, site.model, _with_functions(operator, functions), records)

    largest_cost = (1.0 - criterion.min_improvement) ** 2 * base.cost
    budget = _budget(records)
    for number, (name, (formula, law, has_scale)) in enumerate(laws.items()):
        scale = _best_scale(splines, operator, law, largest) if has_scale else 1.0
        table, size = _table(operator, law, scale * largest)
        combined = np.eye(len(laws))[:, [number]] if site.second else table
        start = splines.candidate(_with_functions(operator, table), combined)
        if start.predicted_cost >= largest_cost:
            continue
        candidate = completed(start, records, budget)
        if not candidate.cost < WORSE * free.cost:
            continue
        candidate = held_out(candidate, records, folds)
        p_value = criterion.p_value(candidate, free)
        if p_value < criterion.alpha and criterion.improves_enough(candidate, free):
            continue
        unit = site.make.unit(candidate.structure)
        # a law without a scale is homogeneous; its arguments were relative to the largest
        factor = (1.0 if has_scale else float(law(*(1.0 / (unit * largest))))) / size
        _, result = candidate.structure.fitted(records, slices)
        names = list(result.params)
        weight = names[site.weight_indices(names, site.tree)[0]]
        rows.append(
            {
                "law": name,
                "formula": formula,
                "c": float(factor * result.params[weight]),
                "c_std": float(factor * result.params_std[weight]),
                "s": unit * scale * largest[0] if has_scale else np.nan,
                "error": candidate.error,
                "p_value": float(p_value),
            }
        )
    return sorted(rows, key=lambda row: (np.isfinite(row["s"]), row["error"]))


def _best_scale(splines, term, law, largest):
    """Return the scale of a law, relative to the largest argument, of least predicted cost."""
    operator = _with_functions(term, np.zeros((len(splines.columns), 1)))
    problem = splines.site.with_term(operator, splines.model).problem(splines.records)

    def cost(scale):
        return splines.cost(problem, _table(term, law, scale * largest)[0])

    i = int(np.argmin([cost(scale) for scale in _SCALES]))
    bounds = np.log(_SCALES[[max(i - 1, 0), min(i + 1, len(_SCALES) - 1)]])
    return float(np.exp(_minimizer(lambda log_scale: cost(np.exp(log_scale)), bounds)))


def curve_of(site, tree, records, rng):
    """Return the curve of the term with its simultaneous band, see :class:`Unknown`."""
    term = site.make.part(tree)
    samples, n = site.free_arguments(term), _GRID_POINTS[len(term.free)]
    axes = [np.linspace(*ends, n) for ends in np.quantile(samples, _SHOWN_QUANTILES, axis=0).T]
    edges = [np.append(v, 2.0 * v[-1] - v[-2]) - 0.5 * (v[1] - v[0]) for v in axes]
    density = np.histogramdd(samples, edges)[0].ravel() / len(samples)
    points = _grid(axes)
    if site.second:  # where samples are, or next to them
        near = maximum_filter(density.reshape(n, n), 3).ravel() > 0.0
        points, density = points[near], density[near]
    functions = _per_unit(term, points)
    covariance, _ = _errors(site, tree, records)
    std = np.sqrt(np.einsum("ij,jk,ik->i", functions, covariance, functions))
    mean, divisor = np.zeros(len(covariance)), np.where(std > 0.0, std, 1.0)
    draws = rng.multivariate_normal(mean, covariance, _DRAWS, method="eigh")
    half_band = std * np.quantile(np.abs(draws @ functions.T / divisor).max(axis=1), _BAND_LEVEL)
    value = functions @ term.weights
    unit = site.make.unit(tree)
    columns = dict(zip(("argument", "second"), unit * points.T, strict=False))
    columns |= {"value": value, "low": value - half_band, "high": value + half_band}
    return pd.DataFrame(columns | {"density": density})


def _grid(axes):
    """Return the points of a rectangular grid, (n_points, n_axes), the last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _per_unit(term, values):
    """Return the functions at values of the free arguments, for one unit of the other one."""
    if term.linear_in is None:
        return term.functions(values)
    (free,) = term.free
    low, high = term.ranges[1 - free]
    largest = high if high > -low else low
    arguments = np.full((len(values), 2), largest)
    arguments[:, free] = values[:, 0]
    return term.functions(arguments) / largest
