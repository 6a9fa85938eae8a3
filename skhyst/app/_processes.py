"""Worker processes of one session of the page.

joblib shares one set of worker processes among all threads of a process, and ends it where one of
them stops: a search that is stopped in one tab would end that of another.
"""

from contextlib import contextmanager

from joblib import parallel_config
from joblib._parallel_backends import (
    AutoBatchingMixin,
    FallbackToBackend,
    LokyBackend,
    ParallelBackendBase,
    SequentialBackend,
)
from joblib.externals.loky import ProcessPoolExecutor


class _OwnProcesses(AutoBatchingMixin, ParallelBackendBase):
    """Processes that nobody else has; they are started when they are needed first."""

    supports_retrieve_callback = True
    supports_inner_max_num_threads = True
    effective_n_jobs = LokyBackend.effective_n_jobs
    _workers = None

    def configure(self, n_jobs=1, parallel=None, **options):
        n_jobs = self.effective_n_jobs(n_jobs)
        if n_jobs == 1:
            raise FallbackToBackend(SequentialBackend(nesting_level=self.nesting_level))
        if self._workers is None:
            self._workers = ProcessPoolExecutor(n_jobs, env=self._prepare_worker_env(n_jobs=n_jobs))
        self.parallel = parallel
        return n_jobs

    def submit(self, func, callback=None):
        future = self._workers.submit(func)
        if callback is not None:
            future.add_done_callback(callback)
        return future

    def retrieve_result_callback(self, future):
        return future.result()

    def terminate(self):
        self.reset_batch_stats()  # the processes stay for the next call

    def abort_everything(self, ensure_ready=True):
        self.close()
        if ensure_ready:
            self.configure(n_jobs=self.parallel.n_jobs, parallel=self.parallel)

    def close(self):
        """End the processes."""
        if self._workers is not None:
            self._workers.shutdown(kill_workers=True)
        self._workers = None


@contextmanager
def own_processes():
    """Have joblib use processes of its own within the context, which ends them."""
    backend = _OwnProcesses()
    try:
        with parallel_config(backend):
            yield
    finally:
        backend.close()
