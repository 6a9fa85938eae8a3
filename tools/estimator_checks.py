"""Run the checks of scikit-learn over every public estimator with natural arguments.

    python tools/estimator_checks.py [--estimators A,B]

Usually these are the defaults; a meta-estimator wraps an estimator named in its docs, as in
`tests/attack/small_estimators.py`. The processor seconds are printed, and the failed checks except
those that contradict memory (see `tests/test_common.py`); the tests run the same checks over small
estimators. Exit 1 if one fails.
"""

import argparse
import inspect
import sys
import time
import warnings
from pathlib import Path
from unittest import SkipTest

from sklearn.utils.estimator_checks import estimator_checks_generator

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "attack")]

from small_estimators import small_estimators  # noqa: E402
from test_common import MEMORY, MEMORYLESS, expected_failed_checks  # noqa: E402

from skhyst.discovery import all_estimators  # noqa: E402


def natural_estimators():
    """Return name -> new instance with its defaults, around the parts that it asks for."""
    found = small_estimators()
    for name, cls in all_estimators():
        parameters = inspect.signature(cls).parameters
        if all(own.default is not own.empty for own in parameters.values()):
            found[name] = cls()
        elif "method" in parameters and name != "InverseCompensator":
            found[name].set_params(method=parameters["method"].default)
    return found


def failures(estimator):
    """Return the names of the checks that fail, and those that contradict memory among them."""
    known, failed, contradicted = set(expected_failed_checks(estimator)), [], []
    known |= set() if type(estimator).__name__ in MEMORYLESS else set(MEMORY)
    for own, check in estimator_checks_generator(estimator):
        name = check.func.__name__
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                check(own)
        except SkipTest:
            pass
        except Exception as error:
            if name in known:
                contradicted.append(name)
            else:
                failed.append(f"{name} ({type(error).__name__}: {str(error)[:100]})")
    return failed, contradicted


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--estimators", default="")
    given = parser.parse_args()
    natural, n_failed = natural_estimators(), 0
    for name in given.estimators.split(",") if given.estimators else natural:
        begin = time.process_time()
        failed, contradicted = failures(natural[name])
        n_failed += bool(failed)
        words = "; ".join(failed) or f"ok but {len(contradicted)} that contradict memory"
        print(f"{name:32}{time.process_time() - begin:8.1f} s  {words}", flush=True)
    print(f"{n_failed} estimators fail")
    return n_failed > 0


if __name__ == "__main__":
    sys.exit(main())
