"""
What a play operator does
=========================

A play is a piston in a cylinder: the drive moves the piston, and the cylinder follows once the
slack is used up. A weighted sum of plays is the Prandtl-Ishlinskii model.
"""

# %%
# One play
# --------
# The output stands still after each reversal until the drive has changed by the slack, twice the
# threshold.

import matplotlib.pyplot as plt
import numpy as np

from skhyst.hysteresis import PrandtlIshlinskiiOperator

time = np.linspace(0.0, 3.0, 1501)  # s
dt = time[1]
drive = 5.0 * np.sin(2 * np.pi * time) * (1.0 - 0.25 * time)  # V

play = PrandtlIshlinskiiOperator(thresholds=[1.5], weights=[1.0])
output, _ = play.run(drive, dt)

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
left.plot(time, drive, label="drive")
left.plot(time, output, label="play, threshold 1.5 V")
left.set(xlabel="time (s)", ylabel="signal (V)")
left.legend()
right.plot(drive, output, color="C1")
right.set(xlabel="drive (V)", ylabel="play (V)")
plt.show()

# %%
# Many plays
# ----------
# Each play begins to move at a different distance from the reversal, so the sum is a smooth curve.
# With positive weights it is a loop whose area is the energy dissipated per cycle.

thresholds = np.linspace(0.0, 4.5, 10)
model = PrandtlIshlinskiiOperator(thresholds, weights=np.r_[0.4, np.full(9, 0.08)])
response, _ = model.run(drive, dt)

figure, axes = plt.subplots(figsize=(5.0, 4.0), layout="constrained")
axes.plot(drive, response)
axes.set(xlabel="drive (V)", ylabel="response")
plt.show()

# %%
# Two properties of its memory
# ----------------------------
# **Rate independence**: the same drive at a different rate gives the same loop. **Wiping-out**:
# once the drive passes an old turning point, the model forgets the minor loop inside.

slow, _ = model.run(np.interp(np.linspace(0, 3, 6001), time, drive), dt)
print(f"largest difference at a quarter of the speed: {np.abs(slow[::4] - response).max():.1e}")

with_inner_loop, _ = model.run([0.0, 3.0, 1.0, 2.0, 0.5, 4.0, -2.0], dt)
without, _ = model.run([0.0, 4.0, -2.0], dt)
print(f"after the inner loop is wiped out:            {abs(with_inner_loop[-1] - without[-1]):.1e}")

# %%
# So its memory consists of the nested turning points only. They are the operator's state, and a run
# can be interrupted and continued at any sample.

first, state = model.run(drive[:700], dt)
second, _ = model.run(drive[700:], dt, state)
turning_points, _ = state
print("turning points remembered:", np.round(turning_points, 3))
print("in two parts as in one:   ", np.array_equal(np.r_[first, second], response))
