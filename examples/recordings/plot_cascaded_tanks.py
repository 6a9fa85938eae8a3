"""
Two tanks: outflow, overflow and a sensor at its end
====================================================

A pump fills the upper of two tanks, which empties into the lower one. The level of the lower tank
is recorded every 4 s, 1024 samples for the search and 1024 that are held out. The outflow of a tank
increases with its level, but not in proportion, and both tanks overflow at the larger peaks.

Data of Schoukens and Noël, *IFAC-PapersOnLine*, 2017; free to use with that citation.
"""

# %%
# What is declared
# ----------------
# Two lags in series, the linear model of two tanks. Levels at the start are unknown, so they are
# estimated too.

import matplotlib.pyplot as plt
import numpy as np
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

case, X, y, X_test, y_test = load_case("cascaded_tanks", ["pump (V)"], "level")
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test) - case.lead} held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)

# %%
# The saturation of the sensor at the end of its range is found before any search, see
# :func:`~skhyst.records.data_quality`.

for fault in search.data_quality_.itertuples():
    print(f"{fault.fault}: {fault.n_samples} samples; {fault.advice}")
print_errors(case, search, X_test, y_test)

# %%
# The held-out record. A linear model does not know that the overflowing water is lost.

time = X_test.index.get_level_values("time") - 4.0 * case.lead
figure, axes = plt.subplots(3, 1, figsize=(9.0, 7.0), layout="constrained", sharex=True)
axes[0].plot(time, X_test["pump (V)"], "0.3", lw=0.8)
axes[1].plot(time, y_test, "0.6", lw=3, label="measured")
models = fitted_models(search).items()
for (name, model), color in zip(models, ("tab:orange", "tab:blue"), strict=False):
    prediction = model.predict(X_test)
    axes[1].plot(time, prediction, color, lw=1.1, label=name)
    axes[2].plot(time, y_test - prediction, color, lw=1.1)
axes[0].set(ylabel="pump (V)", title="Held-out record")
axes[1].set(ylabel="level (V)")
axes[2].set(ylabel="residual (V)", xlabel="time (s)", xlim=(0.0, np.max(time)))
axes[1].legend(fontsize="small", ncols=3, loc="lower center")
plt.show()

# %%
# The evidence of each claim.

show_evidence(search)

# %%
# Verdict, and what to measure next
# ---------------------------------

print(*search.report().next_steps, sep="\n")
