r"""Whether a residual is white: the portmanteau test.

With the autocorrelations :math:`\hat\rho_k` of n samples,

.. math:: Q = n (n + 2) \sum_{k=1}^{m} \frac{\hat\rho_k^2}{n - k}

has a chi-squared distribution of m degrees of freedom if the samples are white (Ljung and Box,
*Biometrika*, 1978). The lags are 1, 2, 4, ... samples: long correlation shows at the long ones, and
with so few lags little power is lost against short correlation.
"""

import numpy as np
from scipy.special import chdtrc


def whiteness_p_value(series):
    """Return the p-value of the autocorrelation of a list of series, if they are white.

    Parameters
    ----------
    series : sequence of ndarray
        Residuals, each without a gap, with a common mean of zero.

    Returns
    -------
    float
        1 if there is nothing to test.
    """
    n = sum(map(len, series))
    power = sum(float(values @ values) for values in series)
    if not power > 0.0:
        return 1.0
    longest = max(map(len, series)) // 4  # beyond it few products are left
    lags = 2 ** np.arange(max(longest, 1).bit_length()) if longest else np.empty(0, dtype=int)
    total = 0.0
    for lag in lags:
        pairs = sum(max(len(values) - lag, 0) for values in series)
        product = sum(float(values[lag:] @ values[:-lag]) for values in series if len(values) > lag)
        total += n * (n + 2.0) * (product / power) ** 2 / pairs
    return float(chdtrc(len(lags), total)) if len(lags) else 1.0
