"""Writes fitted models of this version into one archive: what later versions have to read.

``python tests/persistence/save_models.py NAME`` writes ``tests/persistence/saved/NAME.tar.xz``. An
archive that was written once stays as it is; another version gets one more.
"""

import io
import json
import platform
import sys
import tarfile
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade, Corrected, Modulated, OnColumn, ScheduledParameters, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.disturbance import Drift, Offset, PeriodicDisturbance
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain, SecondOrderMode
from skhyst.persistence import save_model, to_json
from skhyst.records import stack_records

DT, N = 0.01, 100
FOLDER = Path(__file__).parent / "saved"
CALLS = {"Observer": "filter", "Monitor": "alarms"}  # what answers to X and y instead of X


def recording():
    """Return X, with columns ``drive`` and ``load``, and y: a plant with everything."""
    plays = PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.4])
    parts = []
    for k in range(3):
        rng = np.random.default_rng(k)
        u = (0.5 + 0.5 * k) * np.cumsum(rng.normal(size=N)) / 6
        y = FirstOrderLagOperator(0.04).run(plays.run(u, DT)[0], DT)[0] * (1.0 + 0.1 * k) + 0.1 * k
        frame = pd.DataFrame({"drive": u, "load": np.full(N, 10.0 * k)})
        parts.append((frame, y + 0.002 * rng.normal(size=N)))
    return stack_records(parts, dt=DT)


def compositions(X, y):
    """Return compositions of every kind, in one another too, by name."""
    steps = [("plays", PrandtlIshlinskii(thresholds=[0.0, 0.3])), ("lag", FirstOrderLag())]
    chain, offset, load = Cascade(steps), ("offset", Offset()), ("load", OnColumn(Gain(), 1))
    known = FrozenEstimator(FirstOrderLag().fit(X, y))
    by_load = ScheduledParameters(PrandtlIshlinskii(3), by="load")
    slower = ScheduledParameters(chain, by="load", parameters=["plays__weights"])
    bias = OnColumn(Gain(fit_intercept=False), 1, centered=True)
    return {
        "nested": Cascade([("inner", chain), ("mode", SecondOrderMode())]),
        "held": Cascade([("plays", PrandtlIshlinskii(4)), ("lag", known)]),
        "disturbed": Sum([("model", chain), ("line", PeriodicDisturbance()), ("drift", Drift(1))]),
        "parallel": Sum([*steps, offset]),
        "column": Sum([("model", chain), load]),
        "biased": Cascade([("in", Sum([("u", Gain()), ("load", bias)])), ("lag", FirstOrderLag())]),
        "scaled": Modulated(chain, 1),
        "scaled twice": Modulated(Modulated(chain, 1), "amplitude"),
        "scaled beside": Sum([("model", Modulated(chain, 1)), load, offset]),
        "scheduled": slower,
        "scheduled beside": Sum([("plays", by_load), offset]),
        "scheduled and scaled": Modulated(ScheduledParameters(Gain(), by="load"), "amplitude"),
        "corrected": Corrected(PrandtlIshlinskii(3), Sum([("lag", FirstOrderLag()), offset]), cv=2),
        "search": EffectSearchCV(PrandtlIshlinskii(5), effects=["lag", "drift"], random_state=0),
        "search in columns": EffectSearchCV(
            chain, effects=["auxiliary_input", "amplitude_dependence", "offset"], random_state=0
        ),
    }


def models():
    """Return X, y and an instance of every estimator by name."""
    sys.path.append(str(Path(__file__).parents[1] / "attack"))
    from small_estimators import small_estimators

    X, y = recording()
    return X, y, small_estimators() | compositions(X, y)


def answer(model, X, y):
    """Return what a model makes of the recording."""
    names = CALLS.get(type(model).__name__), "predict", "transform"
    call = next(name for name in names if name and hasattr(model, name))
    seen = (X, y) if call in CALLS.values() else (X,)
    return np.asarray(getattr(model, call)(*seen), dtype=float)


def main(name):
    """Write the archive."""
    X, y, found = models()
    members = {"machine.json": json.dumps(machine()).encode()}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for key, model in found.items():
            own = X if key in compositions(X, y) else X[["drive"]]
            model.fit(own, y)
            path = Path(folder, "model.skops")
            save_model(model, path)
            members[f"{key}.skops"] = path.read_bytes()
            with suppress(TypeError):  # it is no model of skhyst alone
                members[f"{key}.json"] = to_json(model).encode()
            file = io.BytesIO()
            np.save(file, answer(model, own, y))
            members[f"{key}.npy"] = file.getvalue()
    FOLDER.mkdir(exist_ok=True)
    with tarfile.open(FOLDER / f"{name}.tar.xz", "w:xz", preset=9) as archive:
        for key, content in members.items():
            info = tarfile.TarInfo(key)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))


def machine():
    """Return what the last bits of an answer depend on."""
    return [platform.system(), platform.machine(), np.__version__]


if __name__ == "__main__":
    main(*sys.argv[1:])
