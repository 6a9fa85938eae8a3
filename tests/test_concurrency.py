"""Threads, processes and jobs give what one gives; `tools/concurrency.py` does more."""

import multiprocessing
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hostile_data import DT, Case
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV
from threadpoolctl import threadpool_info, threadpool_limits

from skhyst.autoregressive import NARXRegressor
from skhyst.base import one_thread
from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii, Preisach
from skhyst.linear import FirstOrderLag
from skhyst.model_selection import BlockedTimeSeriesSplit

pytestmark = pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
THREADS = 8
METHODS = [own for own in multiprocessing.get_all_start_methods() if own != "forkserver"]
X, Y = Case().numbers()
MODELS = {
    "hysteresis": PrandtlIshlinskii(5, dt=DT),
    "grid": Preisach(5, dt=DT),
    "lag": FirstOrderLag(dt=DT),
    "cascade": Cascade([("plays", PrandtlIshlinskii(3)), ("lag", FirstOrderLag())], dt=DT),
    "regression": NARXRegressor(dt=DT),
}


@pytest.fixture(params=MODELS, scope="module")
def fitted(request):
    return clone(MODELS[request.param]).fit(X, Y)


def in_threads(task, n=2 * THREADS):
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(task, range(n)))


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_threads_share_a_fitted_model(fitted):
    found = in_threads(lambda k: fitted.predict((1.0 + k) * X))
    np.testing.assert_array_equal(found, [fitted.predict((1.0 + k) * X) for k in range(len(found))])


@pytest.mark.slow
def test_fits_in_threads(fitted):
    expected = fitted.predict(X)
    for model in in_threads(lambda k: clone(fitted).fit(X, Y), THREADS):
        np.testing.assert_array_equal(model.predict(X), expected)


def test_steppers_in_threads(fitted):
    expected = fitted.stepper(DT, X[0]).run(X[:, 0])
    for found in in_threads(lambda k: fitted.stepper(DT, X[0]).run(X[:, 0])):
        np.testing.assert_array_equal(found, expected)


def n_threads():
    return [own["num_threads"] for own in threadpool_info() if own["user_api"] == "blas"]


def test_threads_of_linear_algebra_come_back():
    """Contexts that overlap: the first to enter leaves before the second."""
    with threadpool_limits(limits=2, user_api="blas"):
        before = n_threads()
        first, second = one_thread(), one_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert set(n_threads()) == {1}
        second.__exit__(None, None, None)
        assert n_threads() == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
@pytest.mark.parametrize("method", METHODS)
def test_models_go_to_processes(method):
    models = [clone(model).fit(X, Y) for model in MODELS.values()]
    with multiprocessing.get_context(method).Pool(1) as pool:
        fits = [pool.apply_async(clone(model).fit, (X, Y)) for model in models]
        runs = [pool.apply_async(model.predict, (X,)) for model in models]
        for model, fit, run in zip(models, fits, runs, strict=True):
            np.testing.assert_array_equal(run.get(300), model.predict(X))
            np.testing.assert_array_equal(fit.get(300).predict(X), model.predict(X))


def test_a_grid_search_of_two_jobs():
    search = GridSearchCV(
        PrandtlIshlinskii(dt=DT), {"n_operators": [2, 4]}, cv=BlockedTimeSeriesSplit(2)
    )
    one, two = (clone(search).set_params(n_jobs=n).fit(X, Y) for n in (1, 2))
    np.testing.assert_array_equal(one.predict(X), two.predict(X))
    for key in ("mean_test_score", "split0_test_score", "split1_test_score"):
        np.testing.assert_array_equal(one.cv_results_[key], two.cv_results_[key])


COLD = """
import pickle, sys
from concurrent.futures import ThreadPoolExecutor
from sklearn.base import clone
model, X, y = pickle.load(sys.stdin.buffer)
with ThreadPoolExecutor(8) as pool:
    found = list(pool.map(lambda k: clone(model).fit(X, y).predict(X), range(8)))
sys.stdout.buffer.write(pickle.dumps(found))
"""


@pytest.mark.slow
def test_first_use_from_threads_of_two_processes(tmp_path):
    """Nothing is compiled yet, and both write to one empty folder."""
    model = FirstOrderLag(initial_state="zero", dt=DT)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    call, given = [sys.executable, "-W", "error", "-c", COLD], pickle.dumps((model, X, Y))
    with ThreadPoolExecutor(2) as pool:
        done = list(
            pool.map(
                lambda _: subprocess.run(
                    call, input=given, capture_output=True, env=environment, timeout=300
                ),
                range(2),
            )
        )
    expected = clone(model).fit(X, Y).predict(X)
    for process in done:
        assert process.returncode == 0, process.stderr.decode()
        for found in pickle.loads(process.stdout):
            np.testing.assert_array_equal(found, expected)
    assert list(tmp_path.rglob("*.nbi"))
