"""
An oscillator with a hardening spring
=====================================

The silverbox is an electronic circuit that obeys the equation of a mass on a spring which gets
stiffer with the displacement (Duffing), sampled at 610.35 Hz. Ten realisations of a multisine, one
after the other, are used here: a part of the first for the search, the last tenth held out.

Data of Wigren and Schoukens, *European Control Conference*, 2013; free to use with that citation.
"""

# %%
# What is declared
# ----------------
# A linear second-order mode. It lacks the cubic part of the spring, which raises the resonance
# frequency with the amplitude. All nine tenths take some minutes; a fifth of them gives the same
# result.

import matplotlib.pyplot as plt
import numpy as np
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import EffectRankingDisplay, ResidualDisplay

N, LEAD = 16_000, 300  # samples
case, X, y, X_test, y_test = load_case("silverbox", ["drive (V)"], "displacement")
X, y = X[:N], y[:N]
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test)} held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)
print()
print_errors(case, search, X_test, y_test)

# %%
# The evidence: the residual force of mass, damper and linear spring over the displacement.

for evidence in search.evidence_.values():
    for name, (value, std, unit) in evidence.numbers.items():
        print(f"{name}: {value:.4g}" + (f" +- {std:.2g}" if np.isfinite(std) else ""), unit)
show_evidence(search)

# %%
# Candidates of the first round. Static curves before or after the mode distort forces or readings,
# but do not change a resonance frequency.

EffectRankingDisplay.from_search(search)
plt.show()

# %%
# The residual in the held-out part, before and after, once the initial transient has decayed.

predictions = {name: model.predict(X_test)[LEAD:] for name, model in fitted_models(search).items()}
figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
for ax, kind in zip(axes, ("time", "spectrum"), strict=True):
    ResidualDisplay.from_predictions(X_test[LEAD:], y_test[LEAD:], predictions, ax=ax, kind=kind)
plt.show()

# %%
# What to measure next
# --------------------

print(f"verdict: {search.verdict_}")
print(*search.report().next_steps, sep="\n")
