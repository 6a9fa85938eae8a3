"""Scikit-learn-compatible hysteresis and dynamic models for actuators.

The package fits a declared model to a recording, looks at what the model leaves unexplained,
names the physical effect that is missing, adds it and reports the error on held-out data
before and after. See :class:`skhyst.diagnosis.EffectSearchCV`.
"""

__version__ = "0.1.0.dev0"
