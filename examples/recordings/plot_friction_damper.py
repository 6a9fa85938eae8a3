"""
A rotary friction damper: compliance before sliding
===================================================

A full-size band brake for damping the sway of buildings: a drum turns in a band under tension, and
links with play in their pins transmit the force. It was recorded under sines of 0.5 Hz, sampled at
1024 Hz, displacement in inches and force in kip (4.45 kN). The first 60 % are searched.

Data of ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash on GitHub, CC BY-SA 4.0.
"""

# %%
# What is declared
# ----------------
# Coulomb friction with a viscous part: the force jumps when the motion reverses. A real damper has
# compliant links and play in its pins, so the force needs some displacement to build up again; the
# authors call this backlash.

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
# A stiffness of the links and a play in their pins have the same effect at a single speed: both
# delay the force by a displacement. On the held-out part:

print_errors(case, search, X_test, y_test)

# %%
# The loops of that part. The force of the declared model depends on the velocity only; the force of
# the damper builds up over a displacement after each reversal. Two details are in neither model:
# the step near zero force, where a pin crosses its play, and the peaks where the band begins to
# slip.

models = fitted_models(search)
predictions = {name: model.predict(X_test) for name, model in models.items()}
HysteresisLoopDisplay.from_predictions(X_test, y_test, predictions)
plt.show()

# %%
# The evidence, with its numbers: the stiffness after a reversal and the displacement before it
# yields are properties of the links.

for evidence in search.evidence_.values():
    for name, (value, _, unit) in evidence.numbers.items():
        print(f"{name}: {value:.4g} {unit}")
show_evidence(search)

# %%
# What to measure next
# --------------------
print(*search.report().next_steps, sep="\n")
