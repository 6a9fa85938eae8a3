"""Parallel jobs: a job that fails costs its candidate, not the search."""

import warnings
from concurrent.futures import BrokenExecutor

from joblib import Parallel, delayed
from sklearn.exceptions import FitFailedWarning

__all__ = ["side_by_side"]


def side_by_side(jobs, n_jobs, report_progress=lambda *step: None):
    """Return the results of jobs, in order, and the errors of those that failed.

    Where a worker process dies, the jobs that ran at the same time are lost too. Each job is then
    run again on its own, so that only the one that kills its worker is lost.

    Parameters
    ----------
    jobs : iterable of joblib.delayed calls
        The first argument is the effect or the candidate that the job is for.
    n_jobs : int or None
    report_progress : callable
        Called with the name of the next job, the number of finished jobs, and the total.

    Returns
    -------
    list
        None for a job that failed.
    failures : list of (str, str)
        Name and error of each failed job.
    """
    jobs = list(jobs)
    try:
        done = _parallel(jobs, n_jobs, report_progress)
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


def _parallel(jobs, n_jobs, report_progress):
    results, done = _results(jobs, n_jobs), []
    try:
        for _, (about, *_), _ in jobs:
            report_progress(_about(about), len(done), len(jobs))
            done.append(next(results))
        report_progress("", len(done), len(jobs))
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # where `report_progress` raises, running jobs are cancelled
            results.close()
    return done


def _results(jobs, n_jobs):
    """Yield the results of jobs in order, each when it is ready if the backend allows that."""
    try:
        parallel = Parallel(n_jobs=n_jobs, batch_size=1, return_as="generator")
    except ValueError:
        parallel = Parallel(n_jobs=n_jobs, batch_size=1)
    yield from parallel(delayed(_attempt)(job) for job in jobs)


def _attempt(job):
    function, arguments, options = job
    try:
        return function(*arguments, **options), ""
    except Exception as error:  # an effect, such as a user's own, may raise anything
        return None, f"{type(error).__name__}: {error}"


def _alone(job, n_jobs):
    try:
        return _parallel([job], n_jobs, lambda *step: None)[0]
    except BrokenExecutor:
        return None, "its worker process has died twice, as where memory runs out"


def _about(effect_or_candidate):
    names = getattr(effect_or_candidate, "effects", ())
    return getattr(effect_or_candidate, "name", " with ".join(names))
