"""
A ferrite core: saturation of a magnetisation loop
==================================================

Quasi-static loops of the flux density over the field in a core of manganese-zinc ferrite, one
closed loop at each of four amplitudes. The third amplitude is held out.

Data of romanszewczyk/JAmodel on GitHub, MIT licence. There is no time base; a sample is counted as
a second.
"""

# %%
# What is declared
# ----------------
# A Prandtl-Ishlinskii model. Its loops go on rising with the field; a magnet has no more to give
# when all its domains point one way.
#
# Each loop is gone through twice. The first turn brings the memory into the loop and is not scored.

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
# The loop that is held out. The last turn is the one that counts.

models = fitted_models(search)
predictions = {name: model.predict(X_test)[case.washout :] for name, model in models.items()}
HysteresisLoopDisplay.from_predictions(X_test[case.washout :], y_test[case.washout :], predictions)
plt.show()

# %%
# The evidence: the knee of the added stage.

show_evidence(search)

# %%
# Candidates of the first round. A curve at the drive and a curve at the response both end the rise
# of the loops; what tells them apart is the width of the loop beyond the knee.

EffectRankingDisplay.from_search(search)
plt.show()

# %%
# What is left, and what to measure next
# --------------------------------------

print(f"what is left is {search.verdict_}")
print(*search.report().next_steps, sep="\n")
