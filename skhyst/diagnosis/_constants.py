"""The numbers of the search: each with where it comes from, none settled on a single plant."""

import numpy as np

# ---- what counts as something. The error of a model is of interest to a few per cent, as
# ``min_improvement`` says; so is everything that is compared with a range.
NOTICEABLE = 0.05
NEGLIGIBLE = 1e-7  # of the range: an error below that has nothing left to be found

# ---- effort. Halving costs least where each rung keeps a part 1/e; three is the next integer.
FACTOR = 3
TOLERANCE = 1e-5  # relative change of the sum of squares; a claim is worth a few per cent
# Samples in all, above which records are cut, and which are left of them. With independent noise,
# chance changes the gain of an effect that removes the part p of the error by sqrt(2 / (p n)) of
# that gain: by 6 % for the least that is claimed by default.
ENOUGH = 10_000
MOST = 0.8  # of the range, or of the mean power, of a whole record: its first part shows as much
REWEIGHTED = 2  # fits before the first round: the first weights are of a fit without any

# ---- what effects are. Where a name begins and ends is a convention; these are ours.
FLAT = 0.25  # slope at an end of the motion, relative to that at the centre, of what saturates
HARD = 5.0  # shape of a Bouc-Wen force beyond which it follows the motion like a spring
LAST_PIECE = 0.1  # of the motion, at least: the piece behind a kink whose slope goes on beyond it
REPEATS = 2.0  # periods of a sinusoid in the longest record; a slower one is a drift
TANKS = 3  # in a row, at the most
KNEE = 0.6  # of the largest response: levels of a knee start at least a tenth above it
FULL = 0.98  # of the level of a knee, up to which its inverse is well conditioned

# ---- the black box that bounds the noise
LAGS = 2 ** np.arange(9)  # samples that it looks back, logarithmically spaced
STRETCHES = 60  # of consecutive samples, which folds take in turn
TREES = {  # few and small: enough to tell that something is left, not to describe it
    "max_iter": 40,
    "learning_rate": 0.15,
    "max_leaf_nodes": 15,
    "min_samples_leaf": 40,
    "early_stopping": False,
}
PLAYS = 5  # of the drive, evenly spaced
SHIFTS = 200  # of the drive to either side: p-values down to half a per cent
DRAWS = 100  # of noise on the drive: its power to a seventh

# ---- repetitions
BLOCKS = 16  # of the difference between two of them
TRANSIENT = 2.0  # power of a block, relative to the typical one, that still is how it began
SLOW = 3  # degree of the drift between them
