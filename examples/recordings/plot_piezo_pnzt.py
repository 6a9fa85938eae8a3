"""
A ferroelectric ceramic: half a butterfly
=========================================

A PNZT ceramic was driven far beyond the fields of an actuator, with amplitudes of 0.8 to 1.9 kV,
and its displacement recorded in nm, one closed loop of 401 samples at each of five levels. Where
the polarisation switches, the strain reverses, and the loop is a butterfly with wings of unequal
size. The level of 1.5 kV is held out.

Data of mavasbel/matlab-preisach-model on GitHub, which states no licence. There is no time base;
the sampling interval is set to 1 s.
"""

# %%
# What is declared
# ----------------
# A Prandtl-Ishlinskii model, whose response rises with its drive and falls with it. It cannot
# represent a strain that rises towards both ends of the drive: a part is missing that is even in
# the polarisation.
#
# Each loop is run twice. The first cycle sets the memory and is not scored.

import matplotlib.pyplot as plt
from _cases import load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import EffectRankingDisplay, HysteresisLoopDisplay

case, X, y, X_test, y_test = load_case("piezo_pnzt", ["voltage (V)"], "displacement")
search = case.search()
print(search)
levels = ", ".join(y.index.unique("record"))
print(f"loops of {levels} kV to search, {', '.join(y_test.index.unique('record'))} kV held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)
print()
print_errors(case, search, X_test, y_test)

# %%
# The loops of the search, before and after. There are few levels, all different, so each fold
# leaves out a part of every loop: each sample is predicted by a model that was not fitted to it.

HysteresisLoopDisplay.from_search(search)
plt.show()

# %%
# Candidates of the first round, and the evidence for what was claimed.

EffectRankingDisplay.from_search(search)
show_evidence(search)

# %%
# What to make of it
# ------------------
# Names of this kind describe the shape of the response, not its cause. Where the residual has
# structure, the search reports where it is largest:

print(f"verdict: {search.verdict_}")
print(*search.report().next_steps, sep="\n")
