"""Parallel work on a fleet: one device or recording per worker, not divided further."""

from contextlib import contextmanager
from functools import partial

from joblib import Parallel, delayed, effective_n_jobs, parallel_config


@contextmanager
def workers(n_jobs):
    """Provide a function that maps a function over tuples of arguments, on persistent workers.

    With several workers each call runs sequentially on one: dividing it further would gain less
    than sending its parts to the workers of a cluster costs.
    """
    single = effective_n_jobs(n_jobs) == 1
    with Parallel(n_jobs=n_jobs) as parallel:

        def run(function, arguments):
            call = function if single else partial(_undivided, function)
            return parallel(delayed(call)(*each) for each in arguments)

        yield run


def _undivided(function, *arguments):
    with parallel_config("sequential"):
        return function(*arguments)
