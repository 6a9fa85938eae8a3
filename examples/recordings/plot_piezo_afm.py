"""
The scanner of a force microscope: a curve after the hysteresis
================================================================

A piezo tube moves the sample of an atomic force microscope. The authors drove it with slow
triangles and sines of increasing amplitude, 0 to 150 V, at about one sample per second, and read a
strain gauge in counts of its converter. The first 60 % of the x axis are searched, the rest is held
out.

Data of the repository angelut2012/TFAFM_mcu_gui on GitHub, which states no licence.
"""

# %%
# What is declared
# ----------------
# A Prandtl-Ishlinskii model: a sum of plays, whose loops have point symmetry. Those of a piezo that
# is driven by positive voltages do not, and manual fits with an asymmetric part were three times
# better than without it.

import matplotlib.pyplot as plt
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import EffectRankingDisplay, HysteresisLoopDisplay

case, X, y, X_test, y_test = load_case("piezo_afm", ["voltage (V)"], "strain gauge")
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test)} held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)

# %%
# At one sample per second there are no dynamics that would distinguish a curve of the material from
# a curve of the strain gauge, so the result is a list of names that fit equally well. All mean that
# the loops are bent to one side. Every candidate of the first round, with its held-out error:

EffectRankingDisplay.from_search(search)
plt.show()

# %%
# On the later part, which the search has not seen:

print_errors(case, search, X_test, y_test)

# %%
# The loops of that part minus a straight line, before and after.

models = fitted_models(search)
predictions = {name: model.predict(X_test) for name, model in models.items()}
HysteresisLoopDisplay.from_predictions(X_test, y_test, predictions, subtract_line=True)
plt.show()

# %%
# The evidence: the contribution of the added stage over its input, measured and identified.

show_evidence(search)

# %%
# What to measure next
# --------------------

print(*search.report().next_steps, sep="\n")
