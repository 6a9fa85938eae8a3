"""
A ferrite core: saturation of a magnetisation loop
==================================================

Quasi-static loops of the flux density over the field in a core of manganese-zinc ferrite, one
closed loop at each of four amplitudes. The third amplitude is held out.

Data of romanszewczyk/JAmodel on GitHub, MIT licence. There is no time base; the sampling interval
is set to 1 s.
"""

# %%
# What is declared
# ----------------
# A Prandtl-Ishlinskii model. Its loops go on rising with the field; the magnetisation saturates
# when all domains are aligned.
#
# Each loop is run twice. The first cycle sets the memory and is not scored.

import matplotlib.pyplot as plt
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import EffectRankingDisplay, HysteresisLoopDisplay

case, X, y, X_test, y_test = load_case("bh_loops", ["field (A/m)"], "flux density")
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test)} held out")
for label, field in X["field (A/m)"].abs().groupby(level="record"):
    print(f"  loop {label}: up to {field.max():.1f} A/m")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)
print()
print_errors(case, search, X_test, y_test)

# %%
# The held-out loop. Only the last cycle is scored.

models = fitted_models(search)
predictions = {name: model.predict(X_test)[case.washout :] for name, model in models.items()}
HysteresisLoopDisplay.from_predictions(X_test[case.washout :], y_test[case.washout :], predictions)
plt.show()

# %%
# The evidence: the knee of the added stage.

show_evidence(search)

# %%
# Candidates of the first round. A curve at the drive and a curve at the response both limit the
# loops; they differ in the width of the loop beyond the knee.

EffectRankingDisplay.from_search(search)
plt.show()

# %%
# Verdict, and what to measure next
# ---------------------------------

print(f"verdict: {search.verdict_}")
print(*search.report().next_steps, sep="\n")
