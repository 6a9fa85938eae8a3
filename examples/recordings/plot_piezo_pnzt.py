"""
A ferroelectric ceramic: half a butterfly
=========================================

A ceramic of PNZT was driven far beyond the fields of an actuator, 0.8 to 1.9 kV either way, and its
displacement recorded in nm, one closed loop of 401 samples at each of five levels. Where the
polarisation switches, the strain turns round, and the loop becomes the wings of a butterfly, here
of unequal size. The level of 1.5 kV is held out.

Data of mavasbel/matlab-preisach-model on GitHub, which states no licence. There is no time base; a
sample is counted as a second.
"""

# %%
# What is declared
# ----------------
# A Prandtl-Ishlinskii model, whose response rises with its drive and falls with it. A strain that
# rises towards either end of the drive is beyond it: a part is missing that is even in the
# polarisation.
#
# Each loop is gone through twice. The first turn brings the memory into the loop and is not scored.

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
# The loops of the search, before and after. There are few levels and no two alike, so each fold
# leaves out a part of every loop: each sample is predicted by a model that has not seen it.

HysteresisLoopDisplay.from_search(search)
plt.show()

# %%
# Candidates of the first round, and the evidence for what was claimed.

EffectRankingDisplay.from_search(search)
show_evidence(search)

# %%
# What to make of it
# ------------------
# Names of this kind say how the response is bent, not why. Where the verdict is that structure is
# left, the search tells where it stands:

print(f"what is left is {search.verdict_}")
print(*search.report().next_steps, sep="\n")
