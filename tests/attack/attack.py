"""Attack every public estimator with the cases of `hostile_data`.

    python tests/attack/attack.py [--examples 2000] [--minutes 60] [--seed 0] [--estimators A,B]

An estimator that is given a case is right or it refuses. It refuses with an exception of the
documented family, raised where the data are looked at, before it has changed anything; it is right
when its result is finite, that of the same numbers as plain floating point in the same records, and
scales with the units. It takes ten seconds of a processor at the most, and no warning is given but
the documented ones. The table counts the cases of each estimator, and what broke that; each has a
process of its own, of at most 4 GB more, so that what ends the interpreter is counted too. A case
is given to `fit`, or to a fitted estimator.
"""

import argparse
import copy
import json
import linecache
import resource
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from inspect import signature
from pathlib import Path

import numpy as np
import pandas as pd
import sklearn
from hostile_data import DT, Case, cases
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.compose import TransformedTargetRegressor
from sklearn.ensemble import AdaBoostRegressor, BaggingRegressor, VotingRegressor
from sklearn.exceptions import ConvergenceWarning, DataConversionWarning
from sklearn.multioutput import MultiOutputRegressor, RegressorChain
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from small_estimators import NO_GAIN, small_estimators

import skhyst
from skhyst.base import ParametricModel
from skhyst.discovery import all_estimators
from skhyst.exceptions import DivergenceWarning, ExtrapolationWarning, ReachWarning
from skhyst.operators import Operator
from skhyst.records import stack_records

__all__ = [
    "META_ESTIMATORS",
    "attack",
    "attack_composition",
    "attack_inside",
    "attack_interval",
    "examine",
    "instance",
    "models",
    "use",
]

_SECONDS, _BYTES = 10, 4 * 2**30
_OWN, _VALIDATION = (str(Path(package.__file__).parent) for package in (skhyst, sklearn))
_WARNINGS = (
    *(ConvergenceWarning, DataConversionWarning, DivergenceWarning),
    *(ExtrapolationWarning, ReachWarning),
)
_OUTCOMES = ("refused", "done", "unsettled")
_ROUNDING = 1e-9  # of the range of the result
_CLOCK = 1e-6  # where times are rounded
_SINGLE = 1e-5  # where a regressor of scikit-learn calculates in single precision
_ALIKE = 1e-3, 1.02  # results in other units differ by this, or fit worse by this factor

# a regressor of scikit-learn within them has a penalty, which has a unit
_WITH_A_UNIT = {"Corrected", "InverseCompensator"}
# stopped after three steps, they are wherever these led
_UNFINISHED = {"BoucWenStage", "EndStops", "FrictionStage", "GrayBoxHysteresis", "RestoringForce"}


def instance(name, dt=DT):
    """Return a new small estimator, whose interval is that of the data."""
    estimator = small_estimators()[name]
    own = estimator.get_params()
    fixed = {"random_state": 0} if "random_state" in own else {}
    return estimator.set_params(**fixed, **{key: dt for key in own if key.split("__")[-1] == "dt"})


def fitted_use(estimator, X, y):
    """Fit an estimator, and return what it says of the data."""
    return use(clone(estimator).fit(X, y), X, y)


def use(estimator, X, y):
    """Return what a fitted estimator says of the data, (n_samples, ...)."""
    for method in ("predict", "transform"):
        if hasattr(estimator, method):
            found = np.asarray(getattr(estimator, method)(X))
            # NaN of the devices that could not be fitted, which are named
            return np.nan_to_num(found) if getattr(estimator, "failures_", None) else found
    return np.asarray(
        (estimator.filter if hasattr(estimator, "filter") else estimator.alarms)(X, y)
    )


def _attempt(action, estimator, X, y):
    """Return "refused", "done" or "unsettled", and why or the result; or what broke, and None.

    Unsettled is a fit that says that it has not converged: it is wherever rounding has led it.
    """
    before = [_copied(values) for values in (X, y)]
    start = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            outcome, result = "done", action(estimator, X, y)
        except Exception as error:
            if not _is_refusal(error):
                frames = traceback.extract_tb(error.__traceback__)
                return f"{type(error).__name__}: {error} ({_place(frames)})", None
            outcome, result = "refused", str(error)
    for warning in caught:
        named = "feature names" in str(warning.message)  # a frame for an array, or the reverse
        if not (named or issubclass(warning.category, _WARNINGS)):
            file = Path(warning.filename).name
            return f"{warning.category.__name__}: {warning.message} ({file}:{warning.lineno})", None
    if time.process_time() - start > _SECONDS:
        return "too slow", None
    if not all(map(_is_same, before, (X, y))):
        return "its input is another", None
    if outcome == "refused":
        return outcome, result
    if not np.isfinite(result).all():
        return "the result is not finite", None
    stopped = any("has not converged" in str(warning.message) for warning in caught)
    return ("unsettled" if stopped else "done"), result


def _place(frames):
    own = [f for f in frames if f.filename.startswith(_OWN)]
    return f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "outside"


def _is_refusal(error):
    """Whether an error says in words what is wrong: raised by name here, or by scikit-learn."""
    if not isinstance(error, ValueError | TypeError):
        return False
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        file = frame.f_code.co_filename
        if file.startswith(_OWN):
            return "raise " in linecache.getline(file, line)
        if file.startswith(_VALIDATION):
            return True
    return False


def _copied(values):
    return None if hasattr(values, "__next__") else copy.deepcopy(values)


def _is_same(before, values):
    if hasattr(values, "equals"):
        index = getattr(values, "index", None)
        return values.equals(before) and (index is None or index.equals(before.index))
    if isinstance(values, np.ndarray):
        return values.dtype == before.dtype and values.tobytes() == before.tobytes()
    return hasattr(values, "__next__") or hasattr(values, "nnz") or values == before


def attack(name, case, fitted=None):
    """Give a case to an estimator; return what broke, in words, or an empty text.

    ``fitted`` is None for a fit, or the fitted estimator that only predicts.
    """
    action, estimator = (fitted_use, instance(name)) if fitted is None else (use, fitted)
    outcome, found = _attempt(action, estimator, *case.given())
    if outcome not in _OUTCOMES:
        return outcome
    told = case.told()
    if name == "PerDevice" and case.index != "none":
        told = None  # a record is a device
    if told is not None:
        plain, expected = _attempt(action, estimator, *told)
        if plain not in _OUTCOMES or (plain == "refused") != (outcome == "refused"):
            why = found if expected is None else expected
            return f"{outcome}, but as plain numbers {plain}: {why}"[:400]
        same = case.index == "none" or {outcome, plain} == {"done"}  # to the last digit, or settled
        if outcome != "refused" and same and not _differ(found, expected) <= _tolerance(name, case):
            return f"off by {_differ(found, expected):.1e} of the range from plain numbers"
    if fitted is None and outcome == "done" and _scales(name, case):
        return _in_other_units(estimator, case, found)
    return ""


def attack_interval(name):
    """Take the time away from what a fitted estimator is given, or another unit; return what broke.

    "" where nothing did.
    """
    X, y = Case(index="seconds").given()
    y = pd.Series(np.asarray(y, dtype=float), X.index, name="y (um)")
    fitted = small_estimators()[name].fit(X, y)
    for method in _reading(fitted):
        outcome, told = _attempt(_called(method), fitted, X, y.rename("y (mm)") / 1e3)
        if outcome != "refused" or "must be in um" not in told:
            return f"{method} of a response in another unit: {outcome}"
    expected = use(fitted, X, y)
    for container in ("float64", "frame", "polars"):
        outcome, found = _attempt(use, fitted, Case(container=container).given()[0], np.asarray(y))
        if outcome not in _OUTCOMES:
            return outcome
        if outcome == "done" and not np.array_equal(found, expected):
            return f"off by {_differ(found, expected):.1e} of the range without the time"
    return ""


def _reading(fitted):
    """Return the public methods of a fitted estimator that read a response, but those that fit."""
    found = []
    for name in dir(fitted):
        if name.startswith(("_", "fit")) or not callable(getattr(type(fitted), name, None)):
            continue
        parameters = list(signature(getattr(fitted, name)).parameters)
        if parameters[:2] == ["X", "y"] or parameters[:2] == ["X", "y_start"]:
            found.append(name)
    return found


def _called(method):
    return lambda fitted, X, y: np.ravel(getattr(fitted, method)(X, y))


def attack_composition(name, kind, **said):
    """Say parameters in a step, and in the composition of it; return what differs, or ""."""
    data = Case().given()
    step = small_estimators()[name]
    if not said.keys() <= step.get_params().keys():
        return ""
    own = kind(clone(step).set_params(**said))
    outcomes = [_attempt(fitted_use, one, *data) for one in (own, kind(step, **said))]
    (by_step, found), (by_whole, expected) = outcomes
    if by_step != by_whole or by_step not in _OUTCOMES:
        return f"{by_step}, but {by_whole} where the composition says it"
    return "" if by_step == "refused" or np.array_equal(found, expected) else "is another model"


# a meta-estimator around an estimator, as neutral as it can be, so that its result is that of it
META_ESTIMATORS = {
    "TransformedTargetRegressor": TransformedTargetRegressor,
    "VotingRegressor": lambda own: VotingRegressor([("own", own)]),
    "VotingRegressor, array": lambda own: VotingRegressor([("own", _behind_an_array(own))]),
    "MultiOutputRegressor": MultiOutputRegressor,
    "RegressorChain": RegressorChain,
    "BaggingRegressor": lambda own: BaggingRegressor(own, 1, bootstrap=False),
    "BaggingRegressor, drawn": lambda own: BaggingRegressor(
        _behind_an_array(own), 1, random_state=0
    ),
    "AdaBoostRegressor": lambda own: AdaBoostRegressor(own, n_estimators=1, random_state=0),
}


def _behind_an_array(own):
    return make_pipeline(FunctionTransformer(np.asarray, validate=False), own)


def _two_records(n=120):
    rng = np.random.default_rng(0)
    drives = np.cumsum(rng.normal(size=(2, n)), axis=1)
    late = [np.convolve(u, 0.3 * 0.7 ** np.arange(n))[:n] + 0.1 * u**2 for u in drives]
    late = [y + 0.02 * rng.normal(size=n) for y in late]
    return stack_records([(u[:, None], y) for u, y in zip(drives, late, strict=True)], dt=DT)


def attack_inside(name, kind):
    """Fit an estimator by itself and inside a meta-estimator; return what broke, or an empty text.

    Its result is that of the records, or that of one record in samples where it says so, or it is
    refused. Rows that are drawn are no recording: only what has no memory may be fitted to them.
    """
    X, y = _two_records()
    several = kind in ("MultiOutputRegressor", "RegressorChain")
    given = np.column_stack([y, 2.0 * y]) if several else y
    outcome, found = _attempt(fitted_use, META_ESTIMATORS[kind](instance(name, dt=None)), X, given)
    if outcome in ("refused", "unsettled"):
        return ""
    if outcome != "done":
        return outcome
    if kind in ("BaggingRegressor, drawn", "AdaBoostRegressor"):
        operator = getattr(type(instance(name)), "operator_class", Operator)
        return "" if operator.memoryless else "fitted to rows that are drawn"
    found = found[:, 0] if several else found
    wanted = [(X, y), (X.to_numpy(), y.to_numpy())]
    results = [_attempt(fitted_use, instance(name, dt=None), *own)[1] for own in wanted]
    keeps = kind in ("TransformedTargetRegressor", "VotingRegressor", "MultiOutputRegressor")
    off = _differ(found, results[0 if keeps else 1])
    return "" if off <= _CLOCK else f"off by {off:.1e} of the range"


def _tolerance(name, case):
    if name in _WITH_A_UNIT and "32" in case.container:
        return _SINGLE
    return _ROUNDING if case.index == "none" else _CLOCK


def _differ(found, expected):
    found, expected = np.asarray(found, dtype=float), np.asarray(expected, dtype=float)
    if found.shape != expected.shape:
        return np.inf
    with np.errstate(over="ignore"):  # the range of what has diverged
        spread = np.ptp(expected) or np.abs(expected).max() or 1.0
        return np.abs(found / spread - expected / spread).max()


def _scales(name, case):
    """Whether the result must be that of the same case in other units."""
    if name in _WITH_A_UNIT | _UNFINISHED or case.values != "plain":
        return False
    if name in NO_GAIN and case.drive_scale != case.response_scale:
        return False
    return bool(case.drive_scale or case.response_scale)


def _in_other_units(estimator, case, found):
    own = {**vars(case), "drive_scale": 0, "response_scale": 0}
    if not {case.container, case.response} <= {"float64", "list", "frame"}:
        return ""  # rounded otherwise
    outcome, expected = _attempt(fitted_use, estimator, *Case(**own).given())
    if outcome == "unsettled":
        return ""
    if outcome != "done":
        return f"in other units {outcome}: {expected}"
    y = Case(**own).numbers()[1]
    for scale in (case.response_scale, case.drive_scale):  # features have the unit of the drive
        scaled = np.ldexp(np.asarray(found, dtype=float), -scale)
        if _differ(scaled, expected) <= _ALIKE[0]:
            return ""
        if scaled.shape == y.shape and _error(scaled, y) <= _ALIKE[1] * _error(expected, y):
            return ""
    return f"off by {_differ(scaled, expected):.1e} of the range in other units"


def _error(predicted, y):
    return np.sqrt(np.mean((predicted - y) ** 2))


def examine(name, n_examples, *, number=0, tell=None, seconds=np.inf):
    """Attack an estimator with drawn cases; return how many, and the broken (how, case, what).

    ``tell`` is called with how, "fit" or "fitted", and each case before it is given.
    """
    broken, n_given, end = [], 0, time.monotonic() + seconds
    known = {"fit": None, "fitted": instance(name).fit(*Case().given())}
    use(known["fitted"], *Case().given())  # compiled now, which is not counted

    @seed(number)
    @settings(
        max_examples=n_examples,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(("fit", "fitted")), cases())
    def give(how, case):
        nonlocal n_given
        if time.monotonic() > end:
            return
        if tell is not None:
            tell(how, case)
        n_given += 1
        what = attack(name, case, known[how])
        if what:
            broken.append((how, case, what))

    give()
    return n_given, broken


def _work(name, n_examples, number, seconds):
    """Examine one estimator in this process; print each case, and what broke."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fitted_use(instance(name), *Case().given())  # compiles what there is
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _BYTES, resource.RLIM_INFINITY))

    def tell(how, case):
        print(json.dumps(["at", how, vars(case)]), flush=True)
        # the fit, that of plain numbers and that in other units; its default action ends all
        signal.setitimer(signal.ITIMER_PROF, 3 * _SECONDS)

    count, broken = examine(name, n_examples, number=number, tell=tell, seconds=seconds)
    signal.setitimer(signal.ITIMER_PROF, 0)
    found = [[how, _short(case), what] for how, case, what in broken]
    print(json.dumps(["end", count, found]), flush=True)


def _short(case):
    usual = vars(Case())
    return {key: value for key, value in vars(case).items() if value != usual[key]}


def run(name, n_examples, number=0, seconds=3600.0):
    """Attack one estimator from outside; return the number of cases and what broke."""
    call = [sys.executable, __file__, "--work", json.dumps([name, n_examples, number, seconds])]
    done = subprocess.run(call, capture_output=True, text=True)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line[:1] == "["]
    if lines and lines[-1][0] == "end":
        return lines[-1][1:]
    if not lines:
        raise RuntimeError(f"The attack on {name} does not begin: {done.stderr[-500:]}")
    _, how, case = lines[-1]
    hung = done.returncode == -signal.SIGPROF
    what = "hang" if hung else f"ends with {done.returncode}: {done.stderr[-200:]}"
    return len(lines), [[how, _short(Case(**case)), what]]


def models():
    """Return the names of the models that meta-estimators are given."""
    return [name for name, cls in all_estimators() if issubclass(cls, ParametricModel)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--examples", type=int, default=2000, help="of each estimator")
    add("--minutes", type=float, default=60.0, help="for all estimators together")
    add("--seed", type=int, default=0)
    add("--estimators", default=",".join(small_estimators()))
    add("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return _work(*json.loads(options.work))
    names, total = options.estimators.split(","), 0
    seconds = 60.0 * options.minutes / len(names)
    print(f"{'estimator':32s}{'cases':>7s}{'broken':>8s}{'seconds':>9s}")
    for name in names:
        start = time.perf_counter()
        count, broken = run(name, options.examples, options.seed, seconds)
        took = time.perf_counter() - start
        print(f"{name:32s}{count:7d}{len(broken):8d}{took:9.0f}", flush=True)
        kinds = Counter(what[:60] for *_, what in broken)
        for kind, times in kinds.most_common(10):
            how, case, what = next(own for own in broken if own[2][:60] == kind)
            print(f"    {times} x {how} {case}: {what[:300]}", flush=True)
        total += len(broken)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
