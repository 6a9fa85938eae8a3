"""A frequency response with its uncertainty."""

from dataclasses import dataclass, replace
from numbers import Integral
from typing import Self

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

_UNCERTAINTIES = ("std", "noise_std", "distortion_std")
_ARRAYS = ("response", *_UNCERTAINTIES, "coherence")  # one row per line


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    r"""A frequency response with its uncertainty.

    .. math:: Y(f) = \sum_i G_i(f)\, U_i(f) + E(f)

    :func:`frequency_response` estimates one from a recording; one measured by an analyser can be
    entered directly. Every standard deviation is the root of :math:`E|\hat G - G|^2`, of real and
    imaginary part together, in the units of ``response``.

    Parameters
    ----------
    frequency : ndarray of shape (n_frequencies,)
        Hz, not negative, strictly increasing.
    response : ndarray of shape (n_frequencies, n_inputs) or (n_frequencies,), complex
        The frequency response :math:`\hat G`, units of the response over those of the input.
    std : ndarray of the shape of ``response`` or None, default=None
        Standard deviation of ``response``, of noise and nonlinear distortion together.
    noise_std : ndarray of the shape of ``response`` or None, default=None
        Standard deviation of ``response`` due to noise alone: its scatter when the same drives are
        measured again.
    distortion_std : ndarray of the shape of ``response`` or None, default=None
        Stochastic nonlinear distortion of **one** realisation of the drive, not of the mean over
        realisations; 0 where it cannot be distinguished from noise.
    coherence : ndarray of shape (n_frequencies,) or None, default=None
        Multiple coherence: the fraction of the response's power that the inputs explain linearly.
    input_names : tuple of str, default=("drive",)
        Names of the inputs.
    output_name : str, default="response"
        Name of the response.
    dt : float, default=1.0
        Sampling interval in s of the recording.
    degrees_of_freedom : float or None, default=None
        Degrees of freedom (complex) from which ``std`` was estimated; None for infinitely many.
    time_unit : {"s", "sample"}, default="s"
        Unit of ``dt``. "sample" where the recording has no time: frequencies are then in
        cycles/sample.

    Raises
    ------
    ValueError
        If the shapes do not match, the frequencies do not increase, or a value is not finite.

    See Also
    --------
    frequency_response : Estimate one from a recording.
    TransferFunction : Fit a model to one, by ``fit_frequency_response``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import FrequencyResponse
    >>> lines = np.array([1.0, 2.0])
    >>> velocity = FrequencyResponse(lines, 2j * np.pi * lines)
    >>> velocity.integrate().response.real.ravel().round(12)
    array([1., 1.])
    """

    frequency: np.ndarray
    response: np.ndarray
    std: np.ndarray | None = None
    noise_std: np.ndarray | None = None
    distortion_std: np.ndarray | None = None
    coherence: np.ndarray | None = None
    input_names: tuple = ("drive",)
    output_name: str = "response"
    dt: float = 1.0
    degrees_of_freedom: float | None = None
    time_unit: str = "s"

    def __post_init__(self):
        frequency = np.asarray(self.frequency, dtype=float)
        if frequency.ndim != 1 or np.any(np.diff(frequency) <= 0) or np.any(frequency < 0):
            raise ValueError(
                "The 'frequency' parameter of FrequencyResponse must be one-dimensional, strictly "
                f"increasing and not negative. Got {self.frequency!r} instead."
            )
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "input_names", tuple(map(str, self.input_names)))
        shape = frequency.size, len(self.input_names)
        for name, value in self._known(_ARRAYS):
            value = np.asarray(value, dtype=complex if name == "response" else float)
            wanted = shape[:1] if name == "coherence" else shape
            if value.shape == shape[:1] and shape[1] == 1:
                value = value.reshape(wanted)
            if value.shape != wanted or not np.isfinite(value).all():
                raise ValueError(
                    f"The '{name}' parameter of FrequencyResponse must be finite and of shape "
                    f"{wanted}. Got shape {value.shape} instead, "
                    f"{np.count_nonzero(~np.isfinite(value))} value(s) not finite."
                )
            object.__setattr__(self, name, value)

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return self.response.shape[1]

    def _scaled(self, factor):
        """Return the response times ``factor``, (n_frequencies, 1) or (n_frequencies, n_inputs)."""
        changes = {name: value * np.abs(factor) for name, value in self._known(_UNCERTAINTIES)}
        return replace(self, response=self.response * factor, **changes)

    def _at(self, kept):
        return replace(self, **{n: v[kept] for n, v in self._known(("frequency", *_ARRAYS))})

    def _known(self, names):
        """Return (name, value) of the fields that are known."""
        pairs = ((name, getattr(self, name)) for name in names)
        return [(name, value) for name, value in pairs if value is not None]

    def compensate_delay(self, delay) -> Self:
        r"""Remove a known delay: multiply by :math:`e^{+j \omega \tau}`.

        Parameters
        ----------
        delay : float or array-like of shape (n_inputs,)
            Delay :math:`\tau` in s, one for all inputs or one per input.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If a delay is not finite, or their number is not that of the inputs.
        """
        delay = np.asarray(delay, dtype=float)
        if delay.shape not in ((), (1,), (self.n_inputs,)) or not np.isfinite(delay).all():
            raise ValueError(
                "The 'delay' parameter of FrequencyResponse.compensate_delay must be a number, or "
                f"one for each of {self.n_inputs} input(s). Got {delay!r} instead."
            )
        return self._scaled(np.exp(2j * np.pi * self.frequency[:, None] * delay))

    def compensate_hold(self, hold="foh") -> Self:
        r"""Remove the effect of the drive's hold between samples, up to half the sampling rate.

        At high frequency a drive that is linear between samples (first-order hold) is weaker than
        a band-limited one with the same samples by :math:`(\sin x / x)^2`,
        :math:`x = \omega \Delta t / 2`; one that is held constant (zero-order hold) by
        :math:`e^{-j x} \sin x / x`.

        Parameters
        ----------
        hold : {"foh", "zoh"}, default="foh"
            Drive between samples: linear, or constant.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If ``hold`` is neither.
        """
        if hold not in ("foh", "zoh"):
            raise ValueError(
                "The 'hold' parameter of FrequencyResponse.compensate_hold must be 'foh' or 'zoh'. "
                f"Got {hold!r} instead."
            )
        cycles = self.frequency[:, None] * self.dt
        drop = np.sinc(cycles)
        return self._scaled(
            1.0 / (drop**2 if hold == "foh" else drop * np.exp(-1j * np.pi * cycles))
        )

    def integrate(self, order=1) -> Self:
        r"""Integrate the response: divide by :math:`(j \omega)^{order}`.

        A measured velocity becomes a displacement. The line at zero, if any, is dropped.

        Parameters
        ----------
        order : int, default=1
            Number of integrations; a negative one differentiates.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If ``order`` is not an integer.
        """
        if not isinstance(order, Integral):
            raise ValueError(
                "The 'order' parameter of FrequencyResponse.integrate must be an integer. Got "
                f"{order!r} instead."
            )
        kept = self._at(self.frequency > 0.0)
        return kept._scaled((2j * np.pi * kept.frequency[:, None]) ** -float(order))

    def restrict(self, low=0.0, high=np.inf) -> Self:
        """Keep the lines from ``low`` to ``high``.

        Parameters
        ----------
        low, high : float, default=0.0, inf
            Hz, both included.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If no line lies between them.
        """
        kept = (self.frequency >= low) & (self.frequency <= high)
        if not kept.any():
            raise ValueError(
                "The 'low' and 'high' parameters of FrequencyResponse.restrict must enclose a line "
                f"between {self.frequency[0]:g} and {self.frequency[-1]:g} Hz. Got {low!r} and "
                f"{high!r} instead."
            )
        return self._at(kept)

    def confidence_radius(self, level=0.95) -> np.ndarray | None:
        r"""Return the radius of the circle around ``response`` that holds the true value.

        :math:`|\hat G - G|^2 / \sigma^2` has an F distribution with 2 and twice
        ``degrees_of_freedom`` degrees of freedom.

        Parameters
        ----------
        level : float, default=0.95
            Probability.

        Returns
        -------
        ndarray of shape (n_frequencies, n_inputs), or None where there is no ``std``
        """
        if self.std is None:
            return None
        dof = np.inf if self.degrees_of_freedom is None else self.degrees_of_freedom
        if np.isinf(dof):
            return self.std * np.sqrt(-np.log1p(-level))
        return self.std * np.sqrt(f_distribution.ppf(level, 2.0, 2.0 * dof))

    def to_frame(self) -> pd.DataFrame:
        """Return the frequency response as a table.

        Returns
        -------
        DataFrame
            One row for each input and frequency, the levels of the index. Columns: ``response``,
            its ``magnitude`` and ``phase`` (degrees), and those of ``std``, ``noise_std``,
            ``distortion_std`` and ``coherence`` that are known.
        """
        index = pd.MultiIndex.from_product(
            [self.input_names, self.frequency], names=["input", "frequency"]
        )
        g = self.response.T.ravel()
        table = {"response": g, "magnitude": np.abs(g), "phase": np.angle(g, deg=True)}
        table |= {name: value.T.ravel() for name, value in self._known(_UNCERTAINTIES)}
        if self.coherence is not None:
            table["coherence"] = np.tile(self.coherence, self.n_inputs)
        return pd.DataFrame(table, index=index)
