"""The constants of the search, each with its origin; none is tuned to a single plant."""

import numpy as np

# ---- what is noticeable. The error of a model is of interest to a few per cent, like
# ``min_improvement``; so are quantities that are compared with a range.
NOTICEABLE = 0.05
NEGLIGIBLE = 1e-7  # of the range: an error below that is rounding, and no effect is sought

# ---- effort. Halving costs least where each rung keeps a fraction 1/e; three is the next integer.
# The evaluations of an identification are counted in rungs, too.
RUNG = 3
BRIEF, USUAL, THOROUGH = RUNG**2, RUNG**3, RUNG**4
FEW, SEVERAL = 3, 9  # candidates that the last rungs of halving keep
TURNS = 9  # at most, between the fits of a black box and of the effects
SETTLING = 3  # fits at most, in which the smoothness of a term is found again
WORSE = 3.0  # sum of squares, relative to the best, above which a term or law is not refitted
TOLERANCE = 1e-5  # relative change of the sum of squares; a claim is worth a few per cent
# Samples in all, above which records are cut, and to how many. With independent noise, the gain of
# an effect that removes the fraction p of the squared error has the relative standard deviation
# sqrt(2 / (p n)): 4.5 % for the least gain that is claimed by default, p = 1 - 0.95^2.
ENOUGH = 10_000
# Fraction of a record's range and root mean square residual that its first part must reach.
MOST = 1.0 - NOTICEABLE
REWEIGHTED = 2  # fits before the first round: the first weights come from an unweighted fit

# ---- definitions of effects. Where a name begins and ends is a convention; these are ours.
# A curve saturates beyond its knee point, where an output that is 10 % larger takes an input that
# is 50 % larger: the definition for magnetic cores (IEC 61869-2).
FLAT = 0.1 / 0.5
REPEATS = 2.0  # periods of a sinusoid in the longest record, at least; a slower one is a drift
FULL = 0.98  # of the level of a knee: its inverse is well conditioned up to there

# ---- the black box that bounds the noise
LAGS = 2 ** np.arange(9)  # lags in samples, logarithmically spaced
BOX_FOLDS = 3  # of cross-fitting: a fit sees two thirds of the samples
STRETCHES = 60  # of consecutive samples, dealt to the folds in turn
TREES = {  # few and small: enough to detect structure, not to describe it
    "max_iter": 40,
    "learning_rate": 0.15,
    "max_leaf_nodes": 15,
    "min_samples_leaf": 40,
    "early_stopping": False,
}
# Plays of the drive, evenly spaced. Straight lines between n thresholds follow a branch that is a
# parabola (Rayleigh's law) to 1 / (2 n)^2 of its height: five to 1 %.
PLAYS = 5
SHIFTS = 200  # of the drive in both directions: p-values down to half a per cent
DRAWS = 100  # of noise on the drive: its power is then known to about a seventh

# ---- repetitions
# Blocks of the difference between two repetitions. Where it is stationary, each of them is the
# strongest equally often, so that a sixteenth of it is taken for a transient in one of 16.
BLOCKS = 16
# Degree of the drift between them. A cubic leaves 1 % of the power of a sine whose period is the
# record, and less of a slower one.
SLOW = 3
