"""Jobs side by side: one that fails costs its candidate, not the search."""

import warnings
from concurrent.futures import BrokenExecutor

from joblib import Parallel, delayed
from sklearn.exceptions import FitFailedWarning

__all__ = ["side_by_side"]


def side_by_side(jobs, n_jobs, tell=lambda *step: None):
    """Return what jobs return, in order, and why those failed that did.

    Where a worker process dies, the jobs that ran beside it are lost too: each is done again alone,
    so that only the one that takes its worker with it is lost.

    Parameters
    ----------
    jobs : iterable of joblib.delayed calls
        The first argument is what a job is about: an effect or a candidate.
    n_jobs : int or None
    tell : callable
        Is called with what the next job is about, the number of those done, and of all.

    Returns
    -------
    list
        None where a job has failed.
    failures : list of (str, str)
        Of each failed job what it is about, and the error.
    """
    jobs = list(jobs)
    try:
        done = _parallel(jobs, n_jobs, tell)
    except BrokenExecutor:
        done = [_alone(job, n_jobs) for job in jobs]
    failures = [
        (_about(first), error)
        for (_, (first, *_), _), (_, error) in zip(jobs, done, strict=True)
        if error
    ]
    for about, error in failures:
        warnings.warn(f"{about} is left out: {error}", FitFailedWarning, stacklevel=2)
    return [result for result, _ in done], failures


def _parallel(jobs, n_jobs, tell):
    results, done = _results(jobs, n_jobs), []
    try:
        for _, (about, *_), _ in jobs:
            tell(_about(about), len(done), len(jobs))
            done.append(next(results))
        tell("", len(done), len(jobs))
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # where `tell` raises, what still runs is cancelled
            results.close()
    return done


def _results(jobs, n_jobs):
    """Yield what jobs return, in order, as soon as it is there where the backend can do that."""
    try:
        parallel = Parallel(n_jobs=n_jobs, batch_size=1, return_as="generator")
    except ValueError:
        parallel = Parallel(n_jobs=n_jobs, batch_size=1)
    yield from parallel(delayed(_attempt)(job) for job in jobs)


def _attempt(job):
    function, arguments, options = job
    try:
        return function(*arguments, **options), ""
    except Exception as error:  # whatever an effect raises, a user's own among them
        return None, f"{type(error).__name__}: {error}"


def _alone(job, n_jobs):
    try:
        return _parallel([job], n_jobs, lambda *step: None)[0]
    except BrokenExecutor:
        return None, "its worker process has died twice, as where memory runs out"


def _about(effect_or_candidate):
    names = getattr(effect_or_candidate, "effects", ())
    return getattr(effect_or_candidate, "name", " with ".join(names))
