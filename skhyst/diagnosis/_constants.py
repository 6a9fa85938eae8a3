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
FEW, SEVERAL = 3, 9  # candidates that are looked at again: the last rungs of halving
TURNS = 9  # at most, between the fits of a black box and of the effects
SETTLING = 3  # fits at most, in which the smoothness of a term is found again
WORSE = 3.0  # sum of squares, relative to the best: what is further away is not settled
TOLERANCE = 1e-5  # relative change of the sum of squares; a claim is worth a few per cent
# Samples in all, above which records are cut, and to how many. With independent noise, the gain of
# an effect that removes the fraction p of the squared error has the relative standard deviation
# sqrt(2 / (p n)): 6 % for the least gain that is claimed by default.
ENOUGH = 10_000
MOST = 0.8  # of a whole record's range or mean power, that its first part must have
REWEIGHTED = 2  # fits before the first round: the first weights come from an unweighted fit

# ---- definitions of effects. Where a name begins and ends is a convention; these are ours.
FLAT = 0.25  # largest slope of a saturating curve at an end, relative to the centre
HARD = 5.0  # shape of a Bouc-Wen force beyond which it follows the motion like a spring
REPEATS = 2.0  # periods of a sinusoid in the longest record, at least; a slower one is a drift
TANKS = 3  # in series, at the most
KNEE = 0.6  # of the largest response, added to a knee's starting levels
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
PLAYS = 5  # of the drive, evenly spaced
SHIFTS = 200  # of the drive in both directions: p-values down to half a per cent
DRAWS = 100  # of noise on the drive: its power is then known to about a seventh

# ---- repetitions
BLOCKS = 16  # of the difference between two repetitions
TRANSIENT = 2.0  # power of a block over the typical one, above which it is the transient
SLOW = 3  # degree of the drift between them
