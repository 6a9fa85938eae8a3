"""What the models share that have an exact inverse."""

from sklearn.utils.validation import check_is_fitted

from ..base import ParametricModel, read_data, run_records

__all__ = [
    "InvertibleModel",
]


class InvertibleModel(ParametricModel):
    """Base of the models whose operator has an ``inverse``."""

    def inverse_predict(self, X):
        """Return the drive that makes the response follow column 0 of ``X``.

        The inverse is exact (Kuhnen 2003).

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the desired response, in its units; the index carries the records.

        Returns
        -------
        ndarray of shape (n_samples,)
            Drive.

        Raises
        ------
        ValueError
            If the model is not strictly monotone: the threshold zero needs a positive weight.
        """
        check_is_fitted(self)
        slices, X, _ = read_data(self, X, reset=False, dt=self.dt)
        return run_records(self.operator_.inverse(), X[:, 0], slices, self._free_run_state())
