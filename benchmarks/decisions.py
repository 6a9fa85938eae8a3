"""What a search's order of growing and testing costs and gains, without any physics.

Run from the root of the project, in about a minute::

    python benchmarks/decisions.py [--runs 100] [--seed 0]

Sixty candidates, twenty groups of three near copies, are columns of noise with the spectrum of a
drive; none, one, two or three of them are in the response, with noise. Two procedures decide by
held-out errors and the test that the search has (`skhyst.noise.block_p_value`, raw and on
innovations), Bonferroni over the sixty:

forward
    Claim the best where it is significant; continue in addition to it.
grow and prune
    Put in the best without a test until none lowers the error by 5 %; then take out what is not
    significant with all others in the model, least first, and again.

Counted are runs with a false claim (a group that is not in the response), and the share of the
groups in the response that are found. The null is nothing in the response. `unlisted`: one of three
effects is in no group.
"""

import argparse
import itertools

import numpy as np

from skhyst.diagnosis._criterion import paired_p_value
from skhyst.noise import fit_noise

N, GROUPS, COPIES, FOLDS, ALPHA, LEAST = 1000, 20, 3, 5, 0.01, 0.05


def coloured(rng, kind, n=N):
    """Return noise of unit variance: white, AR(1) with 0.9, or of the spectrum 1/f."""
    white = rng.standard_normal(n)
    if kind == "white":
        return white
    if kind == "AR(1) 0.9":
        found = np.empty(n)
        state = rng.standard_normal()
        for k in range(n):
            state = 0.9 * state + np.sqrt(1.0 - 0.81) * white[k]
            found[k] = state
        return found
    spectrum = np.fft.rfft(rng.standard_normal(4 * n))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    spectrum[0] = 0.0
    found = np.fft.irfft(spectrum)[:n]
    return found / found.std()


def plant(rng, kind, sizes, listed=None):
    """Return candidates, response and which groups are in it."""
    bases = [coloured(rng, "AR(1) 0.9") for _ in range(GROUPS + 1)]
    columns = [b + 0.2 * coloured(rng, "AR(1) 0.9") for b in bases[:-1] for _ in range(COPIES)]
    y, true = coloured(rng, kind), set()
    for number, size in enumerate(sizes):
        if listed is None or number < listed:
            true.add(number)
            y = y + size * columns[number * COPIES]
        else:
            y = y + size * bases[-1]
    return np.stack(columns, axis=1), y, true


def held_out(columns, y, chosen):
    """Return the residual of held-out blocks for some of the columns."""
    left, block = np.empty(N), np.arange(N) * FOLDS // N
    A = np.column_stack([np.ones(N), columns[:, list(chosen)]])
    for k in range(FOLDS):
        test = block == k
        left[test] = y[test] - A[test] @ np.linalg.lstsq(A[~test], y[~test], rcond=None)[0]
    return left


def p_value(worse, better):
    """Return the p-value of the search's criterion, for all candidates."""
    p = paired_p_value([worse], [better])
    noise = fit_noise([better])
    if noise.law != "white":
        p = 2.0 * min(p, paired_p_value(noise.innovations([worse]), noise.innovations([better])))
    return min(1.0, GROUPS * COPIES * p)


def best_further(columns, y, chosen):
    """Return the candidate that lowers the held-out error most, and its residual."""
    found = [(held_out(columns, y, (*chosen, i)), i) for i in range(GROUPS * COPIES)]
    return min(found, key=lambda own: own[0] @ own[0])


def forward(columns, y, most):
    """Return the groups claimed one after the other."""
    chosen, left = (), held_out(columns, y, ())
    while len(chosen) < most:
        new, i = best_further(columns, y, chosen)
        if not (matters(left, new) and p_value(left, new) < ALPHA):
            break
        chosen, left = (*chosen, i), new
    return {i // COPIES for i in chosen}


def grow_and_prune(columns, y, most):
    """Return the groups that are left of what was grown."""
    chosen, left = (), held_out(columns, y, ())
    while len(chosen) < most:
        new, i = best_further(columns, y, chosen)
        if not matters(left, new):
            break
        chosen, left = (*chosen, i), new
    while chosen:
        reduced = {i: held_out(columns, y, [j for j in chosen if j != i]) for i in chosen}
        needless = {
            i: own
            for i, own in reduced.items()
            if not (matters(own, left) and p_value(own, left) < ALPHA)
        }
        if not needless:
            break
        least = min(needless, key=lambda i: needless[i] @ needless[i])
        chosen, left = tuple(i for i in chosen if i != least), needless[least]
    return {i // COPIES for i in chosen}


def matters(worse, better):
    """Whether the error falls by enough."""
    return np.sqrt(better @ better) < (1.0 - LEAST) * np.sqrt(worse @ worse)


SCENES = {  # sizes over the noise, and how many of them are in the list
    "nothing": ((), None),
    "one": ((0.5,), None),
    "two": ((0.6, 0.6), None),
    "three": ((0.5, 0.5, 0.5), None),
    "three, one unlisted": ((0.5, 0.5, 0.5), 2),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--most", type=int, default=5, help="effects in a model")
    options = parser.parse_args()
    print(f"{'noise':10} {'in the response':20} {'false claims':>26} {'found':>26}")
    for kind, scene in itertools.product(("white", "AR(1) 0.9", "1/f"), SCENES):
        sizes, listed = SCENES[scene]
        false, found = np.zeros(2), np.zeros(2)
        for run in range(options.runs):
            rng = np.random.default_rng([options.seed, run, len(sizes)])
            columns, y, true = plant(rng, kind, sizes, listed)
            for i, decide in enumerate((forward, grow_and_prune)):
                claimed = decide(columns, y, options.most)
                false[i] += bool(claimed - true)
                found[i] += len(claimed & true) / max(len(true), 1)
        shares = [f"{a:.2f} -> {b:.2f}" for a, b in (false / options.runs, found / options.runs)]
        print(f"{kind:10} {scene:20} {shares[0]:>26} {shares[1]:>26}", flush=True)


if __name__ == "__main__":
    main()
