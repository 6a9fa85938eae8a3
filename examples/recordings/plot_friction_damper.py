"""
A rotary friction damper: what gives before it slides
=====================================================

A band brake of full size, meant to take the sway out of buildings: a drum turns in a band under
tension, and links with play in their pins carry the force. It was recorded in sines of 0.5 Hz at
1024 Hz, displacement in inches and force in kip (4.45 kN). The first 60 % are searched.

Data of ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash on GitHub, CC BY-SA 4.0.
"""

# %%
# What is declared
# ----------------
# Coulomb friction with a viscous part: the force jumps when the motion turns round. A real damper
# has links that give and play in its pins, so that the force needs some way to come back; its
# makers speak of backlash.

import matplotlib.pyplot as plt
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import HysteresisLoopDisplay

case, X, y, X_test, y_test = load_case("friction_damper", ["displacement (in)"], "force")
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test)} held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)

# %%
# A stiffness of the links and a play in their pins act alike at a single speed: both make the force
# late by a way. On the part that is held out:

print_errors(case, search, X_test, y_test)

# %%
# The loops of that part. The declared model follows the velocity, which is all that it knows; the
# force of the damper comes back over a way after each turn. Two things are in neither model: the
# step near zero force, where a pin crosses its play, and the peaks where the band lets go.

models = fitted_models(search)
predictions = {name: model.predict(X_test) for name, model in models.items()}
HysteresisLoopDisplay.from_predictions(X_test, y_test, predictions)
plt.show()

# %%
# The evidence, with its numbers: the stiffness after a turn and the way before it yields are what a
# designer would look up in the drawing of the links.

for evidence in search.evidence_.values():
    for name, (value, _, unit) in evidence.numbers.items():
        print(f"{name}: {value:.4g} {unit}")
show_evidence(search)

# %%
# What to measure next
# --------------------
print(*search.report().next_steps, sep="\n")
