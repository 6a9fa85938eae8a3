"""How the work on a fleet is divided: by device or recording, and not further."""

from contextlib import contextmanager
from functools import partial

from joblib import Parallel, delayed, effective_n_jobs, parallel_config


@contextmanager
def workers(n_jobs):
    """Give a function that maps a function over tuples of arguments, on workers that are kept.

    Where several run at a time each is the work of one worker: what it would divide within itself
    is small beside what sending it to the workers of a cluster takes.
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
