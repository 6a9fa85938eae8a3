"""How the work on a fleet is divided: by device or recording, and not further."""

from functools import partial

from joblib import Parallel, delayed, effective_n_jobs, parallel_config


def map_parallel(function, arguments, n_jobs):
    """Return the results of a function for each tuple of arguments, in their order.

    Where several run at a time each is the work of one worker: what it would divide within itself
    is small beside what sending it to the workers of a cluster takes.
    """
    call = function if effective_n_jobs(n_jobs) == 1 else partial(_undivided, function)
    return Parallel(n_jobs=n_jobs)(delayed(call)(*each) for each in arguments)


def _undivided(function, *arguments):
    with parallel_config("sequential"):
        return function(*arguments)
