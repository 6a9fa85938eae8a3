"""
A robot's linear drive: friction
================================

The electro-mechanical positioning system is a carriage on a ball screw, a joint of many robots and
machine tools. It was recorded twice along the same trajectory, in closed loop at 1 kHz; force
pulses disturb the second run, which is held out. Position and motor force are known: the model has
to predict the force that a motion requires.

Data of Janot, Gautier and Brunot, *Workshop on Nonlinear System Identification Benchmarks*, 2019;
free to use with that citation.
"""

# %%
# What is declared
# ----------------
# A mass and a viscous damper, the textbook model of a carriage. Ball screws and guides slide: dry
# friction is known to be missing, and it may differ between the two directions.

import matplotlib.pyplot as plt
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

from skhyst.inspection import ResidualDisplay

case, X, y, X_test, y_test = load_case("emps", ["position (m)"], "force")
search = case.search()
print(search)
print(f"{len(X)} samples to search, {len(X_test)} held out")

# %%
# The search
# ----------

search.fit(X, y)
print_findings(search)

# %%
# On the held-out run, including the pulses:

print_errors(case, search, X_test, y_test)

# %%
# The evidence for friction is the residual force of mass and damper over the velocity. A viscous
# damper would be a straight line through zero; the jump at zero is dry friction. Where the points
# of a picture do not lie on its curve, the name stands in for a different effect: what is missing
# does not depend on the input of that stage alone.

show_evidence(search)

# %%
# The first strokes of the held-out run. The error of the declared model jumps whenever the velocity
# changes; the narrow spikes, cut off here, are the force pulses.

shown = slice(0, 10_000)
models = fitted_models(search)
predictions = {name: model.predict(X_test)[shown] for name, model in models.items()}
figure, axes = plt.subplots(2, 1, figsize=(9.0, 5.6), layout="constrained", sharex=True)
axes[0].plot(X_test["position (m)"].iloc[shown], "0.2")
axes[0].set(ylabel="position (m)", title="Held-out run")
ResidualDisplay.from_predictions(
    X_test[shown], y_test[shown], predictions, ax=axes[1], kind="time", max_points=6000
)
axes[1].set_ylim(-45.0, 45.0)
plt.show()

# %%
# What to measure next
# --------------------

print(*search.report().next_steps, sep="\n")
