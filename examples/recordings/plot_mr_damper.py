"""
A magnetorheological damper: friction, hysteresis and a current
===============================================================

The fluid of this damper thickens in a magnetic field, so that a current sets its force. A press
moved it sinusoidally; records of 5 mm at 3 Hz with 0, 0.5 and 1 A, sampled at 1 kHz, are used here.
The second half of each record is held out.

Data of DanielMaurelE/vRTHS_AMBC_MRdamper on GitHub, MIT licence.
"""

# %%
# What is declared
# ----------------
# A viscous damper. Such a fluid has to yield before it flows, which acts like dry friction, and the
# elastic deformation before it yields makes the force over the velocity a loop. The record of 0.5 A
# comes first.

import matplotlib.pyplot as plt
import numpy as np
from _cases import fitted_models, load_case, print_errors, print_findings, show_evidence

case, X, y, X_test, y_test = load_case("mr_damper", ["displacement (mm)"], "force")
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
# The evidence of each claim. With a single sine, forces that depend on displacement and forces that
# depend on velocity are correlated, so each of them is known less well than their sum.

show_evidence(search)


# %%
# Force over velocity in the held-out part, except for the first samples, where the memory of the
# models is not yet that of the damper.

LEAD = 50  # samples


def draw(ax, search, X, y):
    """Draw force over velocity: measured, declared, and with the effects found."""
    values = {"measured": y.to_numpy()}
    values |= {name: model.predict(X) for name, model in fitted_models(search).items()}
    styles = {"color": "0.6", "lw": 2.5}, {"color": "tab:orange"}, {"color": "tab:blue"}
    for number, (label, record) in enumerate(X.groupby(level="record", sort=False)):
        time = record.index.get_level_values("time")
        velocity = np.gradient(record.iloc[:, 0], time)
        chosen = X.index.get_level_values("record") == label
        for (name, force), style in zip(values.items(), styles, strict=False):
            style = {"lw": 1, "label": None if number else name} | style
            ax.plot(velocity[LEAD:], force[chosen][LEAD:], **style)
    ax.set(xlabel="velocity (mm/s)", ylabel="force (N)")
    ax.legend(fontsize="small", loc="upper left")


figure, axes = plt.subplots(figsize=(6.5, 4.6), layout="constrained")
draw(axes, search, X_test, y_test)
plt.show()

# %%
# Three currents
# --------------
# Now all three records, and the current as a further column of `X`, which the declared model does
# not use.

columns = ["displacement (mm)", "current (A)"]
case, X, y, X_test, y_test = load_case("mr_damper_currents", columns, "force")
search = case.search().fit(X, y)
print_findings(search)
print()
print_errors(case, search, X_test, y_test)

# %%
# The evidence, and the loops of the held-out part, one for each current.

show_evidence(search)
figure, axes = plt.subplots(figsize=(6.5, 4.6), layout="constrained")
draw(axes, search, X_test, y_test)
plt.show()

# %%
# What to measure next
# --------------------

print(*search.report().next_steps, sep="\n")
