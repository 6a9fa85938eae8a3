"""What moved on a fleet is named, and what did not is not."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from skhyst.fleet import PerDevice
from skhyst.inspection import FleetDisplay
from skhyst.linear import Gain

DEVICES, DAYS = [f"stage {i:02d}" for i in range(40)], range(10)


def drawn(seed=0):
    """Values that do not move, with their errors."""
    rng = np.random.default_rng(seed)
    index = pd.MultiIndex.from_product([DEVICES, DAYS], names=["device", "day"])
    std = pd.DataFrame({"gain": 0.1, "frequency": 2.0}, index)
    return std * rng.normal(size=std.shape) + [2.0, 300.0], std


def test_nothing_moves_where_nothing_has_moved():
    moved = [len(FleetDisplay(*drawn(seed)).moves(alpha=0.05)) > 0 for seed in range(20)]
    assert sum(moved) <= 4  # binomial, 20 at 0.05: more than 4 come up once in 400 times


def test_what_moved_is_named_whatever_the_order_of_the_rows():
    params, std = drawn()
    params.loc[("stage 03", slice(6, None)), "frequency"] += 40.0
    params.loc[("stage 05", 0)] = np.nan  # compared with the next day then
    params.loc[("stage 05", 7), "gain"] -= 3.0
    std.loc[("stage 09", slice(None)), "gain"] = np.inf
    params.loc[("stage 09", 4), "gain"] += 9.0  # not determined: nothing is said
    shuffled = params.sample(frac=1.0, random_state=0)
    display = FleetDisplay(shuffled, std)
    moves = display.moves()
    found = set(zip(moves["device"], moves["when"], moves["parameter"], strict=True))
    days = {("stage 03", day, "frequency") for day in range(6, 10)}
    assert found == days | {("stage 05", 7, "gain")}
    assert moves["change"].abs().is_monotonic_decreasing
    display.plot(max_parameters=1)
    assert [ax.get_title(loc="left") for ax in display.ax_] == ["gain"]
    _, axes = pyplot.subplots()
    assert len(display.plot(axes).ax_) == 2


def test_it_is_made_from_models_and_from_a_table():
    rng = np.random.default_rng(0)
    index = pd.MultiIndex.from_product([["a", "b"], [1, 2], range(50)])
    index.names = ["device", "day", "time"]
    X = pd.DataFrame({"drive": rng.normal(size=len(index))}, index)
    y = 2.0 * X["drive"] + 0.01 * rng.normal(size=len(index))
    y.loc["b", 2] = 1.5 * y.loc["b", 2].to_numpy()
    model = PerDevice(Gain(), ["device", "day"]).fit(X, y)
    display = FleetDisplay.from_estimator(model)
    assert ("b", 2) in set(zip(display.moves()["device"], display.moves()["when"], strict=True))
    with pytest.raises(ValueError, match="two levels"):
        FleetDisplay.from_estimator(
            PerDevice(Gain(), ["device"]).fit(
                X.droplevel("day").iloc[:50], y.droplevel("day").iloc[:50]
            )
        )
    table = pd.concat(
        [model.params_.add_prefix("param "), model.params_std_.add_prefix("std ")], axis=1
    ).reset_index(drop=True)
    again = FleetDisplay.from_summary(table, ["a", "a", "b", "b"], [1, 2, 1, 2])
    assert again.moves().equals(display.moves())
    with pytest.raises(ValueError, match="no parameter"):
        FleetDisplay.from_summary(table[[]], ["a", "a", "b", "b"], [1, 2, 1, 2])
