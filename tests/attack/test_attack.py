"""Every estimator is right or refuses, whatever it is given; `attack.py` has many more cases."""

from itertools import cycle
from zlib import crc32

import numpy as np
import pandas as pd
import pytest
from attack import (
    META_ESTIMATORS,
    attack,
    attack_composition,
    attack_inside,
    attack_interval,
    examine,
    instance,
    models,
    use,
)
from hostile_data import DT, Case
from small_estimators import SLOW, small_estimators

from skhyst.base import ParametricModel
from skhyst.compose import Cascade, Modulated, OnColumn, ScheduledParameters, Sum

pytestmark = [
    pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning"),
    pytest.mark.filterwarnings("ignore::skhyst.exceptions.ReachWarning"),
]

QUICK = [name for name in small_estimators() if name not in SLOW]
MODELS = [name for name in QUICK if isinstance(small_estimators()[name], ParametricModel)]

# what was neither right nor refused
FOUND = [
    ("Corrected", Case(container="polars")),
    ("Corrected", Case(container="other byte order", index="two records")),
    ("EffectSearchCV", Case(index="dates, summer time ends")),
    ("EffectSearchCV", Case(response_scale=330, n_further=2)),
    ("FirstOrderLag", Case(index="1e300 s")),
    ("FirstOrderLag", Case(index="dates, pyarrow")),
    ("FirstOrderLag", Case(index="denormal seconds")),
    ("FirstOrderLag", Case(response="text")),
    ("GrayBoxHysteresis", Case(drive_scale=200)),
    ("ModalModel", Case("changing sign")),
    ("ModalModel", Case("one step", n_further=2)),
    ("ModalModel", Case("no response")),
    ("ModalModel", Case("1e300")),
    ("Monitor", Case("no response", drive_scale=-100)),
    ("Monitor", Case("nothing", n_further=2)),
    ("Observer", Case(drive_scale=-100, response_scale=-20)),
    ("Observer", Case(response_scale=-330)),
    ("Observer", Case(index="records repeat", drive_scale=20, response_scale=20, n_further=2)),
    ("PerDevice", Case("no samples")),
    ("PerDevice", Case("denormal response", index="records of two")),
    ("PerDevice", Case(container="dictionary")),
    (
        "PerDevice",
        Case(container="other byte order", response="other byte order", index="two records"),
    ),
    ("PerDevice", Case(index="no record")),
    ("PlayOperators", Case("the largest numbers")),
    ("PlayOperators", Case(container="float16", drive_scale=100)),
    ("PrandtlIshlinskii", Case("1e99 over 1e-99")),
    ("SCNRegressor", Case("denormal drive")),
    ("SCNRegressor", Case(container="float16", drive_scale=100)),
    ("SCNRegressor", Case("the largest numbers")),
    ("SystemLevelHysteresis", Case(drive_scale=250)),
    ("TankChain", Case(drive_scale=-200, response_scale=-200)),
    ("TransferFunction", Case("no response")),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", small_estimators())
def test_right_or_refused(name):
    _, broken = examine(name, 1 if name in SLOW else 3, number=crc32(name.encode()))
    assert broken == []


@pytest.mark.parametrize(("name", "case"), FOUND, ids=str)
def test_what_was_found(name, case):
    assert attack(name, case) == ""


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("DeadBand", Case("1e300", drive_scale=330)),
        ("Gain", Case("the largest numbers")),
        ("InverseCompensator", Case("the largest numbers")),
        ("NARXRegressor", Case("the largest numbers")),
        ("Observer", Case(response="None")),
        ("PlayOperators", Case("the largest numbers")),
        ("RateDependentPrandtlIshlinskii", Case("the largest numbers")),
        ("SCNRegressor", Case("the largest numbers")),
        ("ScheduledParameters", Case("the largest numbers")),
    ],
    ids=str,
)
def test_what_is_too_large_for_the_fitted(name, case):
    fitted = instance(name).fit(*Case().given())
    assert attack(name, case, fitted) == ""


@pytest.mark.parametrize("name", QUICK)
def test_without_the_time_of_the_fit(name):
    assert attack_interval(name) == ""


KINDS = {
    "Cascade": lambda step, **own: Cascade([("step", step)], **own),
    "Sum": lambda step, **own: Sum([("step", step)], **own),
    "OnColumn": lambda step, **own: OnColumn(step, 0, **own),
    "Modulated": lambda step, **own: Modulated(step, "amplitude", **own),
    "ScheduledParameters": lambda step, **own: ScheduledParameters(step, degree=0, **own),
}
SAID = {"dt": 0.05}, {"initial_state": "zero"}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["Cascade", "KelvinVoigt"])
def test_what_a_step_says(name, kind):
    assert [attack_composition(name, KINDS[kind], **said) for said in SAID] == ["", ""]


# models share the code of the compositions: each model in one, each composition of many
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind", "said"), list(zip(MODELS, cycle(KINDS), cycle(SAID), strict=False)), ids=str
)
def test_what_any_step_says(name, kind, said):
    assert attack_composition(name, KINDS[kind], **said) == ""


@pytest.mark.parametrize("name", sorted(set(small_estimators()) - SLOW))
def test_a_lost_row_on_a_straight_line_changes_nothing(name):
    """What the drive was there is known, so all other rows are predicted as if it were there."""
    drive, response = Case().numbers()
    at = len(drive) // 2
    drive[at] = 0.5 * (drive[at - 1] + drive[at + 1])
    times = DT * np.arange(len(drive))
    X, y = pd.DataFrame(drive, times, ["c0"]), pd.Series(response, times)
    fitted, kept = instance(name).fit(X, y), np.arange(len(drive)) != at
    whole, found = use(fitted, X, y)[kept], use(fitted, X[kept], y[kept])
    np.testing.assert_allclose(found, whole, atol=1e-9 * np.abs(whole).max())


# models share the code that meta-estimators meet
OF_EACH_KIND = ["Cascade", "FirstOrderLag", "PrandtlIshlinskii", "Saturation", "Sum"]


@pytest.mark.parametrize("kind", META_ESTIMATORS)
@pytest.mark.parametrize("name", OF_EACH_KIND)
def test_inside_a_meta_estimator(name, kind):
    assert attack_inside(name, kind) == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"),
    list(zip(sorted({*models()} - {*SLOW, *OF_EACH_KIND}), cycle(META_ESTIMATORS), strict=False)),
)
def test_others_inside_a_meta_estimator(name, kind):
    assert attack_inside(name, kind) == ""
