"""The identification of Steinbusch (2020), done again on the stage of that thesis.

    python benchmarks/thesis_cascade.py [--iterations 600] [--candidates 25] [--seed 0]

The stage is simulated (`skhyst.datasets.make_scanning_stage`): the recordings know nothing of
skhyst's operators. Printed with their limits: resonances from white noise of 2 V peak to peak,
the errors of the cascade on the records of the fit and on the six experiments of chapter 5, its
cost and that of differential evolution on (4.2), Table 4.1 and Figure 4.5.
"""

import argparse
import time
import warnings

import numpy as np
import pandas as pd
from scipy.optimize import differential_evolution
from scipy.signal import lti
from sklearn.frozen import FrozenEstimator
from threadpoolctl import threadpool_limits

from skhyst.base import read_data
from skhyst.compose import Cascade
from skhyst.datasets import load_scanning_stage_parameters, make_scanning_stage
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import KelvinVoigt, TransferFunction, frequency_response
from skhyst.optimize import DifferentialEvolution, OperatorProblem

STAGE = load_scanning_stage_parameters()
SMALL = 20_000  # samples of white noise in addition to the triangles where everything is free


def relative_errors(model, X, y):
    """Return (4.3), the RMS error over the stroke, of each record."""
    groups = (y - model.predict(X)).pow(2).groupby("record", sort=False).mean().pow(0.5)
    return groups / y.groupby("record", sort=False).agg(np.ptp)


def report(name, value, limit, unit="%"):
    verdict = "ok" if value <= limit else "ABOVE"
    print(f"  {name:44s} {value:10.4f} {unit:3s} (limit {limit:g}) {verdict}")


def cascade(vibration, *, n_plays=5, n_units=2, **options):
    """Return the chain of Figure 3.3 around a vibration that is held."""
    return Cascade(
        [
            ("hysteresis", PrandtlIshlinskii(n_plays, fit_intercept=False)),
            ("creep", KelvinVoigt(n_units)),
            ("vibration", FrozenEstimator(vibration)),
        ],
        **options,
    )


def fit(model, X, y):
    """Return the fitted model and the seconds that it took."""
    begin = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(X, y)
    return model, time.perf_counter() - begin


def identify_vibration(X, y):
    """Return (4.1) and the fastest spring-damper unit, from the frequency response."""
    response = frequency_response(X, y).compensate_hold().restrict(100.0, 60e3)
    return TransferFunction(9, n_zeros=3).fit_frequency_response(response)


def resonances(model):
    """Return natural frequencies (Hz) and damping ratios of the two lightly damped modes."""
    modes = np.argsort(model.damping_ratios_)[:2]
    modes = modes[np.argsort(model.natural_frequencies_[modes])]
    return model.natural_frequencies_[modes] / (2 * np.pi), model.damping_ratios_[modes]


def show_vibration(title, frequencies, dampings):
    print(f"{title}: {frequencies.round(1)} Hz, damping {dampings.round(5)}")
    pairs = zip(frequencies, STAGE.natural_frequencies, dampings, STAGE.damping_ratios, strict=True)
    for f, true_f, zeta, true_zeta in pairs:
        report(f"frequency, (4.1) has {true_f:.1f} Hz", 100 * abs(f / true_f - 1), 0.5)
        report(f"damping, (4.1) has {true_zeta:.5f}", 100 * abs(zeta / true_zeta - 1), 5.0)


def show_errors(title, model, recordings):
    print(title)
    for X, y in recordings:
        for name, error in relative_errors(model, X, y).items():
            report(str(name), 100 * error, 0.1)


def evolve(problem, bounds, *, candidates, iterations, seed):
    """Minimise (4.2) itself by differential evolution; return F_obj and evaluations."""
    lengths = problem.segment_length
    strokes = np.array([np.ptp(record.y) for record in problem.records])

    def objective(x):
        blocks = problem.evaluate(x, jacobian=False)
        return float(np.mean(np.sqrt(blocks[:, -1, -1] / lengths) / strokes))

    log = problem.log
    box = [bounds[name] for name in problem.names]
    box = [tuple(np.log(pair)) if is_log else pair for pair, is_log in zip(box, log, strict=True)]
    rng = np.random.default_rng(seed)
    start = rng.uniform(*np.transpose(box), (candidates, len(box)))
    found = differential_evolution(
        objective,
        box,
        strategy="rand1bin",
        maxiter=iterations,
        init=start,
        mutation=0.6,
        recombination=0.9,
        tol=0.0,
        polish=False,
        rng=rng,
    )
    return found.fun, found.nfev


def compare(vibration, X, y, arguments):
    """Print the cost and error of each method on the same data, vibration held."""
    bounds = {f"hysteresis__weights[{i}]": (0.0, 2.0) for i in range(5)}
    bounds |= {f"creep__compliances[{i}]": (0.0, 0.5) for i in range(2)}
    bounds |= {f"creep__time_constants[{i}]": (1e-4, 1.0) for i in range(2)}
    settings = {"population": arguments.candidates, "max_iterations": arguments.iterations}
    method = DifferentialEvolution(
        **settings,
        strategy="rand1bin",
        mutation=0.6,
        recombination=0.9,
        project=False,
        polish=False,
        bounds=bounds,
        random_state=arguments.seed,
    )
    rows = {}
    ours, seconds = fit(cascade(vibration), X, y)
    rows["skhyst"] = relative_errors(ours, X, y).mean(), ours.n_evaluations_, seconds
    start = ours.operator_
    held = (*start.stages[:2], cascade(vibration)._models()[2].starting_values(None)[0])
    slices, array, response = read_data(ours, X, y, reset=True, dt=1.0)
    problem = OperatorProblem(
        type(start)(start.names, held).normalized(),
        ours._record_data(slices, array, response),
        fixed=ours.held_parameters(),
    )
    begin = time.perf_counter()
    options = {"candidates": arguments.candidates, "iterations": arguments.iterations}
    with threadpool_limits(1, "blas"):  # as in fit
        best, evaluations = evolve(problem, bounds, seed=arguments.seed, **options)
    rows["differential evolution on (4.2)"] = best, evaluations, time.perf_counter() - begin
    theirs, seconds = fit(cascade(vibration, method=method), X, y)
    rows["the same, sum of squares"] = (
        relative_errors(theirs, X, y).mean(),
        theirs.n_evaluations_,
        seconds,
    )
    print(pd.DataFrame(rows, index=["F_obj", "evaluations", "seconds"]).T.to_string())
    # (4.2) is a mean of roots, skhyst's objective the root of a mean
    report("F_obj over that of the evolution", rows["skhyst"][0] / best, 1.01, "")
    report("sum of squares over the evolution's", (ours.fit_error_ / theirs.fit_error_) ** 2, 1, "")
    report("100 evaluations over the evolution's", 100 * ours.n_evaluations_ / evaluations, 1.0, "")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=600)
    parser.add_argument("--candidates", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    X, y, _ = make_scanning_stage(random_state=arguments.seed)
    validation = make_scanning_stage("validation", random_state=arguments.seed + 1)[:2]
    noise = make_scanning_stage("small_signal", random_state=arguments.seed + 2)[:2]

    vibration = identify_vibration(*noise)
    show_vibration("Resonances from the frequency response", *resonances(vibration))
    _, velocity, _ = make_scanning_stage(
        noise[0], measured="velocity", random_state=arguments.seed + 3
    )
    response = frequency_response(noise[0], velocity).compensate_hold().integrate()
    from_velocity = TransferFunction(9, n_zeros=3)
    from_velocity.fit_frequency_response(response.restrict(100.0, 60e3))
    show_vibration("and from the velocity", *resonances(from_velocity))

    model, seconds = fit(cascade(vibration), X, y)
    title = f"Vibration held: {model.n_evaluations_} evaluations, {seconds:.2f} s; RMS over stroke"
    show_errors(title, model, [(X, y), validation])

    both = pd.concat([X, noise[0][:SMALL]]), pd.concat([y, noise[1][:SMALL]])
    model.set_params(vibration=TransferFunction(9, n_zeros=3), warm_start=True)
    model, seconds = fit(model, *both)
    title = f"Then all free: {model.n_evaluations_} evaluations, {seconds:.2f} s; RMS over stroke"
    show_errors(title, model, [(X, y), validation])
    stage = model.operators_["vibration"]
    light = np.argsort(stage.damping_ratios)[:2][::-1]
    show_vibration(
        "Resonances", stage.natural_frequencies[light] / (2 * np.pi), stage.damping_ratios[light]
    )

    print("The same data and objective, vibration held")
    compare(vibration, X, y, arguments)

    print("Table 4.1: F_obj by the number of spring-dampers, (4.1) held (thesis: 0.0090, ...)")
    printed = TransferFunction.from_system(lti(STAGE.numerator, STAGE.denominator))
    for n_units, thesis in zip(range(1, 5), (0.0090, 0.0070, 0.0065, 0.0065), strict=True):
        model, _ = fit(cascade(printed, n_units=n_units), X, y)
        error = relative_errors(model, X, y).mean()
        print(f"  {n_units} {error:.6f} (thesis {thesis:.4f}), {model.n_evaluations_} evaluations")

    print("Figure 4.5: RMS over stroke by the number of plays, 10 Hz")
    loop = X.loc[["10 Hz"]], y.loc[["10 Hz"]]
    for n_plays in range(1, 11):
        model, _ = fit(cascade(printed, n_plays=n_plays, n_units=3), *loop)
        print(f"  {n_plays:2d} {100 * relative_errors(model, *loop).mean():.4f} %")

    print("The slowest spring-damper by the records of the fit, (4.1) held")
    for names in (list(X.index.unique("record")), ["100 Hz", "1000 Hz"]):
        model, _ = fit(cascade(printed, n_units=3), X.loc[names], y.loc[names])
        value, std = (
            [found[f"creep__{name}[2]"] for name in ("compliances", "time_constants")]
            for found in (model.params_, model.params_std_)
        )
        slow = relative_errors(model, X.loc[["1 Hz"]], y.loc[["1 Hz"]]).iloc[0]
        print(
            f"  {', '.join(names):28s} compliance {value[0]:.4f} ± {std[0]:.4f}, time constant "
            f"{value[1]:.3f} ± {std[1]:.3f} s, error at 1 Hz {100 * slow:.3f} %"
        )


if __name__ == "__main__":
    main()
