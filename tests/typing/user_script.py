"""What a user writes, checked by pyright: it is not run."""

from pathlib import Path
from typing import assert_type

import numpy as np
import pandas as pd

import skhyst
from skhyst.compose import Cascade
from skhyst.control import FeedforwardPI, InverseCompensator
from skhyst.diagnosis import EffectSearchCV, Report, next_experiment
from skhyst.export import to_c
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag
from skhyst.operators import Stepper
from skhyst.persistence import from_json, load_model, save_model, to_json
from skhyst.records import read_records, record_slices, stack_records


def session():
    X, y = read_records("recording.csv", drive="voltage", response="position", time="time")
    assert_type(X, pd.DataFrame)
    assert_type(y, pd.Series)
    stacked, response = stack_records([(X, y), (X, y)], labels=["first", "second"])
    print(stacked.columns, response.name, record_slices(X)[0].dt, skhyst.__version__)

    steps = [("hysteresis", PrandtlIshlinskii(5)), ("lag", FirstOrderLag())]
    model = Cascade(steps, dt=1e-3).fit(X, y)
    assert_type(model, Cascade)
    assert_type(model.predict(X), np.ndarray)
    assert_type(model.params_, dict[str, float])
    stepper = model.stepper(dt=1e-4)
    assert_type(stepper, Stepper)
    print(stepper.step(0.5), stepper.run(np.zeros(3)), stepper.copy().state)

    search = skhyst.diagnosis.EffectSearchCV(PrandtlIshlinskii(), n_jobs=2, random_state=0).fit(
        X, y
    )
    assert_type(search, EffectSearchCV)
    assert_type(search.effects_, list[str])
    assert_type(search.error_after_, float)
    assert_type(search.history_, pd.DataFrame)
    assert_type(search.residual_after_, np.ndarray)
    print(search.verdict_.upper(), search.best_estimator_.predict(X))
    assert_type(search.report(), Report)
    assert_type(search.report().to_html("report.html"), str)
    print(next_experiment(search, (0.0, 100.0)).reason)

    inverse = InverseCompensator(model).fit(X, y)
    assert_type(inverse.predict(X), np.ndarray)
    controller = FeedforwardPI(0.1, 20.0, compensator=inverse)
    print(skhyst.control.simulate_loop(model.stepper(), controller, np.zeros(10), dt=1e-3))
    assert_type(to_c(inverse, "controller", name="stage"), list[Path])
    save_model(model, "model.skops")
    print(load_model("model.skops"), from_json(to_json(model)))
