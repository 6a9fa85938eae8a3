"""
An oscillator with hysteresis in its equation of motion
=======================================================

A mass on a spring, and in parallel with the spring a hysteretic element: the Bouc-Wen oscillator,
whose resonance shifts and broadens with the force. This recording is *simulated*, at 750 Hz, by the
program of the benchmark of Noël and Schoukens, *Workshop on Nonlinear System Identification
Benchmarks*, 2016, with noise in the part that is searched. There are many published figures to
compare with.

Data of forgi86/dynonet on GitHub, MIT licence.
"""

# %%
# What is declared
# ----------------
# A second-order mode from force to displacement. A hysteresis in series before or after it is not
# the right structure: the hysteretic force acts on the mass and depends on its displacement, so the
# equation of motion itself has to change.
#
# The training record has five equal periods, which begin at rest. Two periods are searched here, so
# that the run is short.

import matplotlib.pyplot as plt
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import ResidualDisplay

case, X, y, X_test, y_test = load_case("bouc_wen_benchmark", ["force (N)"], "displacement")
period = case.lead
X, y = X[: 2 * period], y[: 2 * period]
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test) - period} held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)
print()
print_errors(case, search, X_test, y_test)

# %%
# The evidence: the residual force of mass, damper and spring over the displacement, by direction of
# the motion.

show_evidence(search)

# %%
# The test period, which has no noise: a part of it, and the spectrum of the residual.

models = fitted_models(search)
predictions = {name: model.predict(X_test)[period:] for name, model in models.items()}
X_test, y_test = X_test[period:], y_test[period:]
figure, axes = plt.subplots(1, 2, figsize=(11.0, 4.2), layout="constrained")
time = X_test.index.get_level_values("time")
time, shown = time - time[0], slice(0, 600)
axes[0].plot(time[shown], y_test[shown], "0.6", lw=3, label="measured")
for (name, prediction), color in zip(predictions.items(), ("tab:orange", "tab:blue"), strict=False):
    axes[0].plot(time[shown], prediction[shown], color, lw=1.1, label=name)
axes[0].set(xlabel="time (s)", ylabel=y_test.name)
axes[0].legend(fontsize="small", loc="lower right")
ResidualDisplay.from_predictions(X_test, y_test, predictions, ax=axes[1], kind="spectrum")
plt.show()

# %%
# The result
# ----------
# The model has the equation of the simulated plant, so its parameters have a physical meaning.

for name, value in search.best_estimator_.params_.items():
    std = search.best_estimator_.params_std_[name]
    print(f"{name:24s} {value:12.5g} +- {std:.2g}")
print(f"\nverdict: {search.verdict_}")
print(*search.report().next_steps, sep="\n")
