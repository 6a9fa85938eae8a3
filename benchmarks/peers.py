"""Libraries of system identification on the same recordings: `python benchmarks/peers.py`.

Polynomial NARX models of skhyst, sysidentpy, fastcan and pysindy, and of a model of skhyst that has
the physics, on measured recordings, which are not part of the project, and on a simulated piezo
stage. What is not installed is left out (`pip install sysidentpy fastcan pysindy`; skhyst needs
none of them; `sysidentpy` 0.9 needs NumPy below 2.4).

All polynomials have degree three and two lags of drive and response. How many terms are taken is
left to each library's own criterion; fastcan has none and takes ten. Everything else is at its
default. Errors are root mean squares of free runs over the part that is held out, of which no
library sees anything, without the first 100 samples; a free run begins with the first measured
ones, the physical model's at rest. One that leaves ten times the range of the response has
diverged. Times are those of one fit in processor time, after a first one that compiles.
"""

import importlib
import time
import warnings
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from recordings import SHARED, load_cascaded_tanks, load_silverbox

from skhyst.autoregressive import NARMAXRegressor
from skhyst.compose import Cascade
from skhyst.datasets import triangle
from skhyst.datasets.simulation import Plant, PlantEffect, kelvin_voigt, plays
from skhyst.fluid import TankChain
from skhyst.hysteresis import PrandtlIshlinskii, RestoringForce
from skhyst.linear import KelvinVoigt

DEGREE, LAGS, N_TERMS = 3, 2, 10
LEAD, N_FIT = 100, 8_000  # samples


def silverbox():
    """Return the multisine of the silverbox: the first part, and the last tenth; V."""
    u, y = load_silverbox("multisine")
    stop = int(0.9 * len(y))
    model = RestoringForce(3, damping_degree=1, fit_hysteresis=False, dt=1 / 610.35)
    return u[:N_FIT, 0], y[:N_FIT], u[stop:, 0], y[stop:], model


def cascaded_tanks():
    """Return the two tanks, which begin under way; V."""
    (u, y), (u_test, y_test) = load_cascaded_tanks("train"), load_cascaded_tanks("test")
    model = TankChain(2, overflow=True, initial_state="estimate", dt=4.0)
    return u[:, 0], y, u_test[:, 0], y_test, model


def simulated_stage():
    """Return triangles of a simulated stage with plays and creep, the later ones smaller; um."""

    def core(signal, step):
        return plays(signal, step, [0.0, 3.0, 8.0, 15.0, 25.0], [0.06, 0.02, 0.015, 0.01, 0.008])

    def creep(signal, step):
        return kelvin_voigt(signal, step, [0.1, 1.0], [0.07, 0.09])

    dt, rng = 0.01, np.random.default_rng(0)
    (plant,) = PlantEffect("dynamics", creep).changes([Plant({"core": (core,), "dynamics": ()})])
    parts = []
    for peaks in ((45.0, 30.0, 15.0), (40.0, 20.0, 10.0)):
        drives = [triangle(peak, 1.2, n_cycles=3, dt=dt)["drive"] for peak in peaks]
        u = np.concatenate(drives)
        parts += [u, plant.respond(u, dt=dt) + 0.005 * rng.normal(size=u.size)]
    return *parts, Cascade([("loop", PrandtlIshlinskii()), ("creep", KelvinVoigt(2))], dt=dt)


def fit_physics(u, y, model):
    """Fit a model of skhyst that has the physics; return its free run of (u, y)."""
    model.fit(u[:, None], y)
    return lambda u, y: model.predict(u[:, None])


def fit_skhyst(u, y, _):
    options = {"input_lags": range(LAGS + 1), "output_lags": range(1, LAGS + 1)}
    model = NARMAXRegressor(DEGREE, **options, initial_output="measured").fit(u[:, None], y)
    return lambda u, y: model.predict(u[:, None], y)


def fit_sysidentpy(u, y, _):
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    options = {"basis_function": Polynomial(degree=DEGREE), "estimator": LeastSquares()}
    model = FROLS(xlag=LAGS, ylag=LAGS, **options)
    model.fit(X=u[:, None], y=y[:, None])
    return lambda u, y: model.predict(X=u[:, None], y=y[:LAGS, None])[:, 0]


def fit_fastcan(u, y, _):
    from fastcan.narx import make_narx

    sizes = {"n_terms_to_select": N_TERMS, "max_delay": LAGS, "poly_degree": DEGREE}
    model = make_narx(u[:, None], y, **sizes, include_zero_delay=[True], refine_verbose=0)
    model.fit(u[:, None], y)
    return lambda u, y: np.ravel(model.predict(u[:, None], y_init=y[: model.max_delay_]))


def fit_pysindy(u, y, _):
    import pysindy

    def delayed(signal):
        return np.column_stack((signal[1:], signal[:-1]))

    library = pysindy.PolynomialLibrary(degree=DEGREE)
    model = pysindy.DiscreteSINDy(feature_library=library)
    model.fit(delayed(y)[:-1], t=1, x_next=delayed(y)[1:], u=delayed(u)[1:])

    def run(u, y):
        states = model.simulate(delayed(y)[0], t=len(u) - 1, u=delayed(u)[1:])
        return np.concatenate([y[:1], states[:, 0]])

    return run


RECORDINGS = {"silverbox": silverbox, "cascaded_tanks": cascaded_tanks, "": simulated_stage}
PEERS = {
    "skhyst, physics": fit_physics,
    "skhyst, NARMAX": fit_skhyst,
    "sysidentpy": fit_sysidentpy,
    "fastcan": fit_fastcan,
    "pysindy": fit_pysindy,
}


def compare(fit, u, y, u_test, y_test, model):
    """Return the error of a free run that is held out, and the seconds of a fit."""
    fit(u[:500], y[:500], model)  # compiles
    start = time.process_time()
    run = fit(u, y, model)
    seconds = time.process_time() - start
    try:
        off = run(u_test, y_test) - y_test
    except (ValueError, OverflowError) as error:
        return f"fails: {error}"[:40], seconds
    if not np.isfinite(off).all() or np.abs(off).max() > 10.0 * np.ptp(y_test):
        return "diverges", seconds
    return f"{np.sqrt(np.mean(off[LEAD:] ** 2)):.3g}", seconds


def main():
    warnings.simplefilter("ignore")
    print(f"{'recording':18s} {'library':18s} {'version':10s} {'error':>10s} {'fit (s)':>8s}")
    for folder, load in RECORDINGS.items():
        if not (SHARED / folder).exists():
            print(f"{load.__name__:18s} is absent from {SHARED}")
            continue
        parts = load()
        for name, fit in PEERS.items():
            package = name.split(",")[0]
            try:
                importlib.import_module(package)
                found = version(package)
            except (ImportError, PackageNotFoundError):
                print(f"{load.__name__:18s} {name:18s} is not installed")
                continue
            error, seconds = compare(fit, *parts)
            print(
                f"{load.__name__:18s} {name:18s} {found:10s} {error:>10s} {seconds:8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
