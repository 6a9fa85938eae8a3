"""A term without a name: whether it is found where it is, shows what it is, and is not made up.

    python benchmarks/unknown_term.py [--plants N] [--nulls N] [--named N] [--seed S]
        [--names KIND ...]

Plants are a mass on a spring, integrated here by the classical Runge-Kutta method of fourth order
with substeps, not by a model of the package; each lacks one smooth function in its declared model
(``SecondOrderMode``), or nothing. Noise is white, or of first order with a pole at 0.8. Seeds from
0 on were looked at while the search was built; reported are those from 1000 on, the default.

With nothing missing a term must not be claimed, and where a named effect is missing (cubic
stiffness, saturation, creep, a delay) that one must be named and no term be claimed: there the
search has all effects, and what the term takes is compared with that search. Elsewhere it tries no
effect first; the time of a term, of every third plant, is that of the processor relative to such a
search, which only fits the declared model and judges its residual.

Printed are, for each kind of plant, how many of N

- found     have a term claimed
- place     have the right place and argument first, or among those that are not told apart
- band      have the true curve within the band over 90 % of the samples, where the right place is
            first; up to the straight line and the factor that the mode can do as well
- error     predict a fresh record with an error below 1.2 times the noise
- frequency, damping
            have the parameter within 2 standard errors of the truth, as 95.4 of 100 have of a
            normal error; of a force in the equation of motion, of the mode that has, in addition,
            what it can do of the force, see ``promised``
- both      have both so, as 91.1 of 100 have of two independent normal errors
- true      have both within 2 standard errors of the mode without any of the force
- free      of every third plant that lacks a curve, have both within 2 standard errors, and
            determined, where the same model is fitted with a term that may do what the mode can do
            as well (not orthogonal to its parameters)
- law       are offered the right law, of those that have one and the right place first
"""

import argparse
import time
import warnings

import numpy as np
from scipy.signal import lfilter
from sklearn.base import clone

from skhyst.diagnosis import EffectSearchCV
from skhyst.linear import SecondOrderMode

N, DT, SUBSTEPS = 2000, 2e-3, 8
MOTION, DAMPING = "motion of second_order_mode", "damping of second_order_mode"
PARAMETERS = ("gain", "stiffness", "damping")
KINDS = {
    # place, argument, second argument, law
    "notch in the drive": ("drive", "drive", "", None),
    "curve of the sensor": ("response", "output of second_order_mode", "", None),
    "play of the drive": ("drive", "play of the drive", "", None),
    "rate of the drive": ("response", "rate of the drive", "", "quadratic with sign"),
    "dead band in the drive": ("drive", "drive", "", "dead band"),
    "asymmetric spring": (MOTION, "displacement", "", None),
    "quadratic damping": (MOTION, "velocity", "", "quadratic with sign"),
    "product of drive and rate": ("gain of the drive", "rate of the drive", "", "proportional"),
    "damping that depends on the displacement": (DAMPING, "displacement", "", "square"),
    "gain that depends on a play": ("gain of the drive", "play of the drive", "", None),
    "drag that depends on the displacement": (
        MOTION,
        "displacement",
        "velocity",
        "square times quadratic with sign",
    ),
}


def drives(rng):
    """Return a smooth random drive of unit size."""
    u = rng.normal(size=N)
    for pole in (0.9, 0.85):
        u = lfilter([1.0], [1.0, -pole], u)
    return u / u.std()


def play(u, half_gap):
    p, out = 0.0, np.empty(len(u))
    for k, own in enumerate(u):
        p = out[k] = min(max(p, own - half_gap), own + half_gap)
    return out


def creep(u, size, time_constant):
    """Return what follows the drive with a delay of first order."""
    pole = np.exp(-DT / time_constant)
    return size * lfilter([1.0 - pole], [1.0, -pole], u)


def mode(u, frequency, damping, spring=0.0, drag=0.0, cubic=0.0, bent=0.0, both=0.0):
    """Integrate ``x'' + (2 d w + drag |x'| + bent x^2 + both x^2 |x'|) x' + w^2 s(x) = w^2 u``.

    ``s(x) = x + spring max(x, 0)^2 + cubic x^3``.
    """

    def slope(x, v, force):
        own = -(2.0 * damping * frequency + drag * abs(v) + (bent + both * abs(v)) * x**2) * v
        return v, own + frequency**2 * (force - x - spring * max(x, 0.0) ** 2 - cubic * x**3)

    x, v, out, h = float(u[0]), 0.0, np.empty(len(u)), DT / SUBSTEPS
    out[0] = x
    for k in range(1, len(u)):
        step = (u[k] - u[k - 1]) / SUBSTEPS
        for i in range(SUBSTEPS):
            a, c = u[k - 1] + i * step, u[k - 1] + (i + 1) * step
            b = 0.5 * (a + c)
            x1, v1 = slope(x, v, a)
            x2, v2 = slope(x + 0.5 * h * x1, v + 0.5 * h * v1, b)
            x3, v3 = slope(x + 0.5 * h * x2, v + 0.5 * h * v2, b)
            x4, v4 = slope(x + h * x3, v + h * v3, c)
            x += h / 6.0 * (x1 + 2.0 * x2 + 2.0 * x3 + x4)
            v += h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        out[k] = x
    return out


def plant(kind, rng):
    """Return what a plant responds to a drive, the true curve (or None), frequency and damping."""
    w, d = rng.uniform(40.0, 90.0), rng.uniform(0.2, 0.6)
    size, at, wide = rng.uniform(0.2, 0.4), rng.uniform(-0.7, 0.7), rng.uniform(0.25, 0.5)

    def curve(v):
        return size * np.exp(-(((v - at) / wide) ** 2))

    respond = {
        None: lambda u: mode(u, w, d),
        "notch in the drive": lambda u: mode(u + curve(u), w, d),
        "curve of the sensor": lambda u: (lambda x: x + curve(x))(mode(u, w, d)),
        "asymmetric spring": lambda u: mode(u, w, d, spring=0.4 * size),
        "quadratic damping": lambda u: mode(u, w, d, drag=size * 2.0),
    }
    if kind == "asymmetric spring":

        def curve(v):
            return 0.4 * size * np.maximum(v, 0.0) ** 2

    if kind == "quadratic damping":

        def curve(v):
            return size * 2.0 / w**2 * np.abs(v) * v

    if kind == "play of the drive":
        gap, size = 0.1 * 6.0, 1.5 * size  # which is that of the curve, too
        respond[kind] = lambda u: mode(u + curve(play(u, gap)), w, d)
    if kind == "rate of the drive":
        c = size / 60.0**2  # about the size of the drive's rate

        def curve(v):
            return c * np.abs(v) * v

        respond[kind] = lambda u: mode(u, w, d) + curve(np.diff(u, prepend=u[0]) / DT)
    if kind == "product of drive and rate":
        c = size / 60.0

        def curve(rate):
            return c * rate

        respond[kind] = lambda u: mode(u * (1.0 + curve(np.diff(u, prepend=u[0]) / DT)), w, d)
    if kind == "damping that depends on the displacement":

        def curve(v):
            return 2.0 * size / w * v**2

        respond[kind] = lambda u: mode(u, w, d, bent=2.0 * size * w)
    if kind == "gain that depends on a play":
        gap = 0.1 * 6.0

        def curve(p):
            return size * np.tanh(p)

        respond[kind] = lambda u: mode(u * (1.0 + curve(play(u, gap))), w, d)
    if kind == "drag that depends on the displacement":

        def curve(v, rate):
            return 2.0 * size / w**2 * v**2 * np.abs(rate) * rate

        respond[kind] = lambda u: mode(u, w, d, both=2.0 * size)
    if kind == "dead band in the drive":
        gap = rng.uniform(0.3, 0.7)

        def curve(v):
            return -size * 2.0 * np.clip(v, -gap, gap)

        respond[kind] = lambda u: mode(u + curve(u), w, d)
    return respond[kind], curve, w, d


def study(kind, seed):
    """Return what was found of one plant, as a dict of str to bool or None."""
    rng = np.random.default_rng([seed, sum(map(ord, kind or ""))])
    respond, curve, w, d = plant(kind, rng)
    u = drives(rng)
    clean = respond(u)
    size = rng.uniform(0.01, 0.04) * np.std(clean)
    noise = rng.normal(size=N)
    if rng.random() < 0.5:
        noise = lfilter([0.6], [1.0, -0.8], noise)
    data = u[:, None], clean + size * noise
    own = {"declared": SecondOrderMode(dt=DT), "max_effects": 0, "random_state": 0}
    search, row = timed(data, seed % 3 == 0, **own)
    found = search.unknown_
    row["found"] = found is not None
    if kind is None or found is None:
        return row | {"verdict": search.verdict_}
    place, argument, second, law = KINDS[kind]
    first = (found.place, found.argument, found.second_argument) == (place, argument, second)
    both = f"{argument} and the {second}" if second else argument
    told = f"{place}: a function of the {both}" in found.ambiguous_with
    row["place"] = first or told
    model, values = found.estimator, {"natural_frequency": w, "damping_ratio": d}
    row["true"] = all(has_values(model, values))
    gain, offset = gain_and_offset(model)
    if first:
        values = promised(found, curve, w, d)
        own = found.curve
        v, weight = own["argument"].to_numpy(), own["density"].to_numpy()
        at = [v] + ([own["second"].to_numpy()] if second else [])
        # a spring and a damper, a gain, or of a parameter its value
        linear = at if place == MOTION else [] if place.startswith(PARAMETERS) else [v]
        truth, line = curve(*at), np.stack([*linear, np.ones_like(v)], axis=1)
        if place.endswith("drive"):  # gain times (u + curve) is what is known
            truth = truth / gain
        elif argument.startswith("output"):  # which is scaled by the gain, and so is x + curve
            x = (v - offset) / gain
            truth = x + curve(x) - v
        elif argument == "displacement" and not second:
            truth = curve(v + offset)
        left, root = truth - own["value"].to_numpy(), np.sqrt(weight)
        straight = np.linalg.lstsq(line * root[:, None], left * root, rcond=None)[0]
        left -= line @ straight
        half = 0.5 * (own["high"] - own["low"]).to_numpy()
        row["band"] = bool(weight[np.abs(left) <= half].sum() >= 0.9 * weight.sum())
        if law is not None:
            row["law"] = law in set(found.laws["law"])
    fresh = 0.7 * drives(rng)
    error = found.estimator.predict(fresh[:, None]) - respond(fresh)
    level = size * np.std(noise)
    row["error"] = bool(np.sqrt(np.mean(error**2) + level**2) <= 1.2 * level)
    row["frequency"], row["damping"] = has_values(model, values)
    row["both"] = row["frequency"] and row["damping"]
    if seed % 3 == 0 and not second:  # of a surface it takes minutes
        free = clone(model).fit(*data)
        row["free"] = all(has_values(free, values))
    return row


NAMED = {
    "cubic_stiffness": lambda u, w, d: mode(u, w, d, cubic=0.3),
    "output_saturation": lambda u, w, d: np.clip(mode(u, w, d), -1.1, 1.3),
    "creep": lambda u, w, d: mode(u + creep(u, 0.3, 0.2), w, d),
    "delay": lambda u, w, d: np.append(np.zeros(5) + u[0], mode(u, w, d)[:-5]),
}


def timed(data, is_compared, declared, **options):
    """Return a search with a term, and the time of the term relative to the search before it.

    Seconds of the processor, if it is to be compared with the search without a term.
    """
    search, row = EffectSearchCV(declared, unknown=True, **options), {}
    begin = time.process_time()
    search.fit(*data)
    whole = time.process_time() - begin
    if is_compared:
        begin = time.process_time()
        clone(search).set_params(unknown=False).fit(*data)
        row["times"] = whole / (time.process_time() - begin) - 1.0
    return search, row


def named(seed):
    """Return what a search with all effects finds of a plant whose effect has a name."""
    rng = np.random.default_rng([seed, 1])
    effect = list(NAMED)[seed % len(NAMED)]
    u, w, d = drives(rng), rng.uniform(40.0, 90.0), rng.uniform(0.2, 0.6)
    clean = NAMED[effect](u, w, d)
    y = clean + 0.02 * np.std(clean) * rng.normal(size=N)
    search = EffectSearchCV(SecondOrderMode(dt=DT), unknown=True, random_state=0).fit(u[:, None], y)
    step = search.seconds_.get("unknown term", 0.0)
    return {
        "effect": effect,
        "named": effect in search.effects_,
        "term": search.unknown_ is not None,
        "times": step / max(sum(search.seconds_.values()) - step, 1e-9),
    }


def gain_and_offset(model):
    """Return gain and intercept of a model of a mode."""
    known = {name.split("__")[-1]: value for name, value in model.params_.items()}
    return known["gain"], known["intercept"]


def promised(found, curve, w, d):
    """Return the frequency and the damping that a term orthogonal to them leaves to the mode.

    The true force is ``a x + s v + constant`` plus a combination of the functions of the term, none
    of which a mode can do: the regression of the truth on all of these, by the density of the data.
    The mode has the line: ``x'' / w^2 + (2 d / w + s) x' + (1 + a) x``, and no fitted value decides
    about ``a`` and ``s``. If the damping depends on the displacement, it has the constant.
    """
    if found.place not in (MOTION, DAMPING):
        return {"natural_frequency": w, "damping_ratio": d}
    loop, (_, offset) = found.estimator.operator_, gain_and_offset(found.estimator)
    names = [name for name in (found.argument, found.second_argument) if name]
    grid = dict(zip(("argument", "second"), names, strict=False))
    at = {name: found.curve[column].to_numpy() for column, name in grid.items()}
    places = np.stack([*at.values()], axis=1) / abs(loop.linear.gain)
    line = {"constant": np.ones(len(places))}
    if found.place == DAMPING:  # of which each function is a multiple of the velocity
        velocity = loop.curve.ranges[1, 1]
        places = np.insert(places, 1, velocity, axis=1)
        functions = loop.curve.functions(places) / velocity
    else:
        functions, line = loop.curve.functions(places), line | at
    truth = curve(*(v + offset * (name == "displacement") for name, v in at.items()))
    columns = np.stack([*line.values(), *functions.T], axis=1)
    root = np.sqrt(found.curve["density"].to_numpy())
    columns, scale = columns * root[:, None], np.linalg.norm(columns, axis=0)
    shares = np.linalg.lstsq(columns / scale, truth * root)[0] / scale
    share = dict(zip(line, shares, strict=False))
    a = share.get("displacement", 0.0)
    s = share["constant"] if found.place == DAMPING else share.get("velocity", 0.0)
    return {
        "natural_frequency": w * np.sqrt(1.0 + a),
        "damping_ratio": (d + 0.5 * w * s) / np.sqrt(1.0 + a),
    }


def has_values(model, values):
    """Return of each parameter whether it is determined, and within two standard errors."""
    known = {name.split("__")[-1]: name for name in model.params_}
    errors = {n: abs(model.params_[known[n]] - truth) for n, truth in values.items()}
    return [bool(e <= 2.0 * model.params_std_[known[n]] < np.inf) for n, e in errors.items()]


def line(title, rows, names):
    """Return a line of the table."""
    cells = []
    for name in names:
        own = [row[name] for row in rows if name in row]
        cells.append(f"{sum(own)}/{len(own)}" if own else "-")
    times = [row["times"] for row in rows if "times" in row]
    text = f"{np.median(times):8.1f}, at most {max(times):.1f}" if times else f"{'-':>8}"
    return f"{title:42}" + "".join(f"{cell:>10}" for cell in cells) + text


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=6, help="of each kind")
    parser.add_argument("--nulls", type=int, default=40, help="with nothing missing")
    parser.add_argument("--named", type=int, default=8, help="with a named effect missing")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--names", nargs="*", default=list(KINDS), choices=list(KINDS))
    options = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    nulls = [study(None, options.seed + i) for i in range(options.nulls)]
    noise = sum(row.get("verdict") == "noise" for row in nulls)
    claimed = sum(row["found"] for row in nulls)
    print(
        f"nothing missing: {claimed} of {len(nulls)} claimed ({noise} verdicts of noise)",
        flush=True,
    )
    rows = [named(options.seed + i) for i in range(options.named)]
    right, claimed = (sum(row[name] for row in rows) for name in ("named", "term"))
    lost = [row["effect"] for row in rows if not row["named"]]
    most = max((row["times"] for row in rows), default=0.0)
    text = f"{right} of {len(rows)} named (not {lost}), {claimed} terms claimed"
    print(f"a named effect missing: {text}")
    print(f"the term takes at most {most:.2f} times the search before it", flush=True)
    names = ["found", "place", "band", "error", "frequency", "damping", "both", "true", "free"]
    names += ["law"]
    print(
        f"{'missing':42}" + "".join(f"{name:>10}" for name in names) + "  times the search before"
    )
    rows = {kind: [] for kind in options.names}
    for kind, own in rows.items():
        own += [study(kind, options.seed + i) for i in range(options.plants)]
        print(line(kind, own, names), flush=True)
    print(line("all", [row for own in rows.values() for row in own], names))


if __name__ == "__main__":
    main()
