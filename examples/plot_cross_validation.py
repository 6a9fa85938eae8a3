"""
Cross-validation that respects records and memory
=================================================

Neighbouring samples share their noise and their memory, so a shuffled fold tests nothing. Whole
records are left out instead, and the first samples of a record may be excluded from the score.
"""

# %%
# Records that start anywhere
# ---------------------------
# Six records of an actuator that was in use before each of them, so that the memory at the start
# is not known: in the fit, the drive before each record is estimated along with the weights.

import matplotlib.pyplot as plt
import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.metrics import root_mean_squared_error
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.pipeline import make_pipeline

from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.model_selection import RecordKFold, washout_scorer
from skhyst.preprocessing import PlayOperators
from skhyst.records import stack_records

rng = np.random.default_rng(3)


def actuator(drive):
    """Return the response to a drive, by 200 plays with zero initial states."""
    thresholds = np.linspace(0.0, 1.0, 200)
    plays, response = np.zeros(200), np.empty(len(drive))
    for k, u in enumerate(drive):
        plays = np.maximum(u - thresholds, np.minimum(u + thresholds, plays))
        response[k] = 0.5 * u + plays @ np.exp(-thresholds / 0.3) / 80.0
    return response


def record():
    """Return drive and response of a record; its first quarter is cut off."""
    turns = np.r_[0.0, rng.uniform(0.2, 1.0, 14) * (-1.0) ** np.arange(14)]
    drive = np.interp(np.linspace(0, 14, 700), np.arange(15), turns)
    response = actuator(drive) + 0.002 * rng.normal(size=700)
    return drive[175:], response[175:]


X, y = stack_records([record() for _ in range(6)], dt=2e-3)

# %%
# How many plays?
# ---------------
# `GridSearchCV` works as for any estimator: the index of `X` tells the model where records end, and
# tells the splitter which rows belong together. The scorer leaves out the first 200 samples of each
# record: they are simulated, not scored.

scorer = washout_scorer(root_mean_squared_error, washout=200)
grid = {"n_operators": [1, 3, 10, 30], "thresholds": ["grid", "quantile"]}
model = PrandtlIshlinskii(initial_state="estimate")
search = GridSearchCV(model, grid, cv=RecordKFold(3), scoring=scorer).fit(X, y)
print("best:", search.best_params_)

figure, axes = plt.subplots(figsize=(6.5, 3.8), layout="constrained")
results = search.cv_results_
for spacing in grid["thresholds"]:
    chosen = results["param_thresholds"] == spacing
    count = results["param_n_operators"][chosen].astype(int)
    error, spread = -results["mean_test_score"][chosen], results["std_test_score"][chosen]
    axes.errorbar(count, error, spread, fmt="o-", capsize=3, label=spacing)
axes.axhline(0.002, color="0.4", linestyle=":", label="sensor noise")
axes.set(xscale="log", yscale="log", xlabel="number of plays", ylabel="held-out error (RMS)")
axes.legend()
plt.show()

# %%
# What the washout is for
# -----------------------
# Without it, the unknown memory at the start of each record counts as an error of the model.

model = search.best_estimator_
for name, scoring in (
    ("whole records", "neg_root_mean_squared_error"),
    ("after the washout", scorer),
):
    errors = -cross_val_score(model, X, y, cv=RecordKFold(3), scoring=scoring)
    print(f"{name:18s} {errors.mean():.5f}")

# %%
# Any regressor
# -------------
# Play operators as features give a memory to any regressor of scikit-learn, in a pipeline that
# takes part in the same cross-validation.

pipeline = make_pipeline(PlayOperators(20), RidgeCV(np.geomspace(1e-6, 1.0, 13)))
errors = -cross_val_score(pipeline, X, y, cv=RecordKFold(3), scoring=scorer)
print(f"ridge regression behind plays, after the washout: {errors.mean():.5f}")
