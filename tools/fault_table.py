"""Faults as people make them: what the code says, what it would wrongly say, which tests must fail.

A fault is found by its text, in whatever file that stands. Faults of the diagnosis with a
``version`` belong to one way of deciding between candidates, and are found in that one alone.
"""

from dataclasses import dataclass

from fault_table_diagnosis import CRITERION, DIAGNOSIS

__all__ = ["FAULTS", "Fault"]


@dataclass(frozen=True)
class Fault:
    """A fault that some test must notice.

    Attributes
    ----------
    name : str
    area : str
        ``models``, ``composition``, ``optimisation`` or ``diagnosis``.
    original, faulty : str
        The code, which stands in the package once, and what takes its place.
    tests : str
        Arguments of pytest. Paths are patterns; those that match nothing are left out.
    version : str
        Of the code that it belongs to; empty for all.
    """

    name: str
    area: str
    original: str
    faulty: str
    tests: str
    version: str = ""


def _of(area, version="", tests="", faults=()):
    return [
        Fault(name, area, original, faulty, own or tests, version)
        for name, original, faulty, own in faults
    ]


_TANGENTS = "tests/operators/test_acceptance.py -k 'derivatives_and_pieces and ({})'".format

_MODELS = [
    (
        "play: a tangent is taken over on falling branches alone",
        "count += (play == low) | (play == high)",
        "count += play == high",
        "tests/**/test_play*.py",
    ),
    (
        "plays: the first loading is left by a fall, whatever the sign of the drive",
        "elif abs(value) < abs(last):",
        "elif value < last:",
        "tests/**/test_prandtl_ishlinskii*.py -k 'equals_the_sum or definition'",
    ),
    (
        "plays: turning points that a play still sees are dropped",
        "if a != b or b != c:",
        "if a != b:",
        "tests/**/test_prandtl_ishlinskii*.py -k 'bounded or definition or equals_the_sum'",
    ),
    (
        "thresholds: a branch counts with its whole length",
        "half_spans = 0.5 * np.abs(np.diff(turning_points(record)))",
        "half_spans = np.abs(np.diff(turning_points(record)))",
        "tests/operators/test_plays.py tests/operators/test_thresholds.py",
    ),
    (
        "rate-dependent plays: the rate does not widen the lower end of the slack",
        "play = value - slack\n                sign = -1.0",
        "play = value - thresholds[k]\n                sign = -1.0",
        "tests/operators/test_acceptance.py -k 'derivatives_and_pieces and rate-dependent'",
    ),
    (
        "rate-dependent inverse: a play that moves down moves its threshold up",
        "slope += weight\n                    offset += weight * slack",
        "slope += weight\n                    offset -= weight * slack",
        "tests/**/test_rate_dependent*.py -k inverse_at_known_rates",
    ),
    (
        "Preisach: the triangle at the end of a branch has the wrong sign",
        "bend = diagonal[i, 0] * s * (1.0 - s) + diagonal[j, 0] * t * (1.0 - t)",
        "bend = diagonal[i, 0] * s * (1.0 - s) - diagonal[j, 0] * t * (1.0 - t)",
        "tests/operators/test_acceptance.py -k 'cut_signal and relays'",
    ),
    (
        "Preisach: a turning point is wiped out too late",
        "while depth > 0 and sign * (value - points[depth - 1]) >= 0.0:",
        "while depth > 1 and sign * (value - points[depth - 2]) >= 0.0:",
        "tests/**/test_preisach*.py tests/**/test_superpositions.py -k 'not recovery'",
    ),
    (
        "ramps: the slope of a kernel misses a factor of two",
        "slope = 2.0 / (high - low) if low < value < high else 0.0",
        "slope = 1.0 / (high - low) if low < value < high else 0.0",
        _TANGENTS("ramps"),
    ),
    (
        "Dahl: the tangent of the length on the way back",
        "by_x_c = -sign * slope * path / x_c",
        "by_x_c = -slope * path / x_c",
        _TANGENTS("Dahl"),
    ),
    (
        "Dahl: the gap decays with the length of a sample, not of the way",
        "path = min(abs(change) / x_c, _LONGEST)",
        "path = min(change * change / x_c, _LONGEST)",
        "tests/**/test_dahl*.py -k 'closed_form or exact or rate_independent'",
    ),
    (
        "LuGre: the Stribeck tangent misses a factor of two",
        "steep = 2.0 * (1.0 - ratio) * bell * square",
        "steep = (1.0 - ratio) * bell * square",
        _TANGENTS("LuGre"),
    ),
    (
        "LuGre: the bristles' rate is that at the start of a sample",
        "slip = speed * gap * by_w / gamma",
        "slip = speed * gap / gamma",
        "tests/**/test_lugre*.py -k 'not recovery and not come_back'",
    ),
    (
        "Duhem: a power of the drive is differentiated without its exponent",
        "by_end += j * change / scale * moments[1, j - 1]",
        "by_end += change / scale * moments[1, j - 1]",
        _TANGENTS("Duhem"),
    ),
    (
        "Duhem: the series of the middle range ends too early",
        "_SMALL, _MIDDLE, _LARGE = (0.02, 8), (0.25, 12), (1.0, 18)",
        "_SMALL, _MIDDLE, _LARGE = (0.02, 8), (0.25, 6), (1.0, 18)",
        "tests/**/test_duhem*.py -k 'not come_back'",
    ),
    (
        "Bouc-Wen: the asymmetry acts on the ratio with the wrong sign",
        "(0.0, 1.0 / f, 0.0, -sign * r / f**2),",
        "(0.0, 1.0 / f, 0.0, sign * r / f**2),",
        _TANGENTS("Bouc-Wen and not stage"),
    ),
    (
        "Bouc-Wen: gamma without its half",
        "turned = np.sign(self.alpha) * 0.5 * (1.0 - self.ratio)",
        "turned = np.sign(self.alpha) * (1.0 - self.ratio)",
        "tests/**/test_bouc_wen*.py -k printed",
    ),
    (
        "Jiles-Atherton: the third slope starts from the first",
        "k3 = increment(add(s, 0.5, k2)",
        "k3 = increment(add(s, 0.5, k1)",
        "tests/**/test_jiles_atherton*.py -k order_four",
    ),
    (
        "Jiles-Atherton: the field does not feed back on the reversible part",
        "inverse = 1.0 / (1.0 - 3.0 * b * c * slope)",
        "inverse = 1.0 / (1.0 - 3.0 * b * slope)",
        "tests/**/test_jiles_atherton*.py -k 'textbook or anhysteretic or derivatives'",
    ),
    (
        "tanh: the rate without the interval",
        "rate = (u1 - u0) / dt",
        "rate = u1 - u0",
        "tests/**/test_tanh*.py -k 'not recovery'",
    ),
    (
        "restoring force: the polynomials stand at the start of a substep alone",
        "force = 0.5 * (force0 + polynomials(q + delta, end, scale, springs, dampers))",
        "force = force0",
        "tests/**/test_restoring_force*.py tests/**/test_oscillator.py"
        " -k 'order or independent or integration or solve_ivp or substep'",
    ),
    (
        "hold: the straight line and the constant are swapped",
        'if hold == "foh":\n        return ad',
        'if hold == "zoh":\n        return ad',
        "tests/linear/test_linear.py tests/operators/test_linear.py",
    ),
    (
        "linear blocks: what is left over starts from the wrong sample",
        "x, float(u[len(y) - 1]))",
        "x, float(u[len(y)]))",
        "tests/linear/test_linear.py tests/operators/test_linear.py -k blocks",
    ),
    (
        "linear tangents: the state at rest does not move with the parameters",
        "return tangent_system(discrete, by, rest, rest_by, begins",
        "return tangent_system(discrete, by, rest, 0.0 * rest_by, begins",
        "tests/linear/test_linear.py tests/operators/test_linear.py -k rest_moves",
    ),
    (
        "delay: the slope per sample is taken for one per second",
        "np.concatenate([du, -slopes[:, None] / dt], axis=1)",
        "np.concatenate([du, -slopes[:, None]], axis=1)",
        _TANGENTS("delay"),
    ),
    (
        "clocks that differ: the shift grows the other way",
        "return self.shift + self.skew * time",
        "return self.shift - self.skew * time",
        "tests/linear/test_linear.py -k clocks",
    ),
    (
        "delay: the part of a sample is taken from the wrong side",
        "in cubic_weights(back - delay)",
        "in cubic_weights(3.0 - (back - delay))",
        "tests/**/test_delay.py tests/linear/test_linear.py -k 'shift or delay'",
    ),
    (
        "creep in logarithmic time: the slowest unit does not stand for slower ones",
        "both[:, -1] *= 1.0 + 1.0 / np.expm1(_SPACING)",
        "both[:, -1] *= 1.0",
        "tests/**/test_log_creep.py -k 'law or superposition'",
    ),
    (
        "creep: the gain at rest of a model without its units",
        'by["model__gain"] = 1.0 + np.sum(operator.compliances)',
        'by["model__gain"] = 1.0',
        "tests/**/test_kelvin_voigt.py -k static_gain",
    ),
    (
        "soft saturation: the knee's tangent misses its logarithm",
        "knee = value * (rest + np.maximum(size, 0.0) - full * size) / n",
        "knee = value * (rest + np.maximum(size, 0.0)) / n",
        _TANGENTS("soft"),
    ),
    (
        "dead zones: the inverse keeps the thresholds of the drive",
        "slopes=1.0 / np.asarray(self.slopes), thresholds=thresholds)",
        "slopes=1.0 / np.asarray(self.slopes))",
        "tests/**/test_*dead_zones.py tests/static/test_static.py -k inverse",
    ),
    (
        "tanks: what flows over is the part of the substep before the ceiling",
        "over = max(q - most, 0.0) * (1.0 - room / move)",
        "over = max(q - most, 0.0) * (room / move)",
        "tests/fluid/test_tank_chain.py -k overflow",
    ),
    (
        "drift: the polynomial goes on beyond the duration",
        "z = np.clip(2.0 * time / self.duration - 1.0, -1.0, 1.0)",
        "z = 2.0 * time / self.duration - 1.0",
        "tests/**/test_disturbance.py",
    ),
    (
        "sinusoid: the frequency's tangent turns the wrong way",
        "(sine * np.cos(phase) - cosine * np.sin(phase))",
        "(sine * np.cos(phase) + cosine * np.sin(phase))",
        _TANGENTS("sinusoid"),
    ),
]

_COMPOSITION = [
    (
        "series: both of two hystereses keep their gain",
        "if stage.owns_gain][:1]",
        "if stage.owns_gain]",
        "tests/operators/test_compose.py",
    ),
    (
        "series: the first stage carries the gain where there is no hysteresis",
        "if any(s.is_shared for s in specs)][-1:]",
        "if any(s.is_shared for s in specs)][:1]",
        "tests/operators/test_compose.py tests/compose/test_cascade.py -k gain",
    ),
    (
        "series: parameters before a curve count as linear",
        "while first > 0 and self.stages[first].signal_linear",
        "while first > 0",
        "tests/operators/test_acceptance.py -k 'linear_all_at_once and series'",
    ),
    (
        "series: every stage rests at the drive",
        "u0 = stage.run(np.array([u0], dtype=float), 1.0, state)[0][0]",
        "stage.run(np.array([u0], dtype=float), 1.0, state)",
        "tests/operators/test_acceptance.py -k rest_stays",
    ),
    (
        "sum: every branch keeps its intercept",
        "s.held or (c and taken)",
        "s.held",
        "tests/operators/test_compose.py -k 'intercept or independent'",
    ),
    (
        "sum: the gain of any branch can be taken out",
        "(c or i == 0)",
        "True",
        "tests/operators/test_compose.py -k 'gain or independent'",
    ),
    (
        "sum: beside an offset the intercept is left free",
        "any(disturbance.has_constant for disturbance in disturbances)",
        "any(False for disturbance in disturbances)",
        "tests/compose/test_sum.py -k intercept",
    ),
    (
        "schedule: Bernstein coefficients in reverse",
        "comb(d, k) * t**k * (1.0 - t) ** (d - k) for d",
        "comb(d, k) * t ** (d - k) * (1.0 - t) ** k for d",
        "tests/compose/test_scheduled_parameters.py -k 'between or polynomial'",
    ),
    (
        "schedule: beyond its range a parameter passes its bounds",
        "np.clip(values, [spec.lower for spec in specs], [spec.upper for spec in specs])",
        "values",
        "tests/compose/test_scheduled_parameters.py -k 'between or polynomial'",
    ),
    (
        "modulation: the sensitivity is that to the column, not to its change",
        "x, coefficients = sign * a - self.reference, self._coefficients",
        "x, coefficients = sign * a, self._coefficients",
        "tests/compose/test_column*.py tests/operators/test_multi_input.py"
        " tests/operators/test_columns.py -k derivatives",
    ),
    (
        "backfitting: the fold's mask is inverted",
        "residual = np.where(self._fold[s.rows] != k, record.y - output, 0.0)",
        "residual = np.where(self._fold[s.rows] == k, record.y - output, 0.0)",
        "tests/compose/test_corrected.py -k 'fold or lag'",
    ),
    (
        "backfitting: the clone of a fold learns from the fold",
        "rows = np.flatnonzero(self._fold != k)",
        "rows = np.flatnonzero(self._fold >= 0)",
        "tests/compose/test_corrected.py -k fold",
    ),
    (
        "backfitting: no damping in the gradient",
        "gradient = adjoint(unexplained) - _DAMPING * change",
        "gradient = adjoint(unexplained)",
        "tests/compose/test_corrected.py -k damped",
    ),
    (
        "thinned records keep the interval",
        '"dt": step * record.dt,',
        '"dt": record.dt,',
        "tests/compose/test_cascade.py -k thin",
    ),
    (
        "a stage gives up its gain, but not that of its other terms",
        "values = np.where(scaled, values / gain, values)",
        "values = np.where(scaled, values, values)",
        "tests/compose/test_compositions.py -k gain",
    ),
    (
        "the free run starts from rest although zero was asked for",
        'return "zero" if known else "rest"',
        'return "rest"',
        "tests/test_base.py tests/test_common.py -k 'state or zero or rest'",
    ),
]

_OPTIMISATION = [
    (
        "bounded step: bounds without a multiplier are held",
        "below, above = multipliers.reshape(2, -1) > 0.0",
        "below, above = multipliers.reshape(2, -1) == 0.0",
        "tests/optimize/test_bounded.py",
    ),
    (
        "bounded step: the way to the lower bound is that to the upper",
        "beyond = np.concatenate([low - s0, s0 - high])",
        "beyond = np.concatenate([low - s0, low - s0])",
        "tests/optimize/test_bounded.py",
    ),
    (
        "non-negative: an unknown at zero is freed by a rising slope",
        "wrong |= ~free & (slope < -_TOLERANCE",
        "wrong |= ~free & (slope > _TOLERANCE",
        "tests/optimize/test_bounded.py",
    ),
    (
        "linear part: bounds of the value, not of its change",
        "gram[index, -1],\n        (problem.lower - x)[index],",
        "gram[index, -1],\n        problem.lower[index],",
        "tests/optimize/test_variable_projection.py -k at_once",
    ),
    (
        "clipped step: a positive parameter may change by any factor",
        "reach = np.where(problem.log, _LARGEST_LOG_STEP, np.inf)",
        "reach = np.full(len(x), np.inf)",
        "tests/optimize/test_variable_projection.py -k 'factor or predicted or truth'",
    ),
    (
        "the step promises half of its slope",
        "return step, -(2.0 * gradient @ step + step @ hessian @ step)",
        "return step, -(gradient @ step + step @ hessian @ step)",
        "tests/optimize/test_variable_projection.py -k 'predicted or single_step'",
    ),
    (
        "a step that does not reduce the sum of squares is taken",
        "if problem.total(reached, select)[-1, -1] <= gram[-1, -1]:",
        "if np.isfinite(problem.total(reached, select)[-1, -1]):",
        "tests/optimize/test_variable_projection.py -k single_step",
    ),
    (
        "weights are not applied to the residual",
        "columns, last = columns * root[:, None], last * root",
        "columns = columns * root[:, None]",
        "tests/optimize/test_weights.py -k long_record",
    ),
    (
        "weights are applied to rows, not their squares",
        "columns *= np.sqrt(record.weights)[:, None]",
        "columns *= record.weights[:, None]",
        "tests/optimize/test_weights.py -k 'twice or generalised or cut'",
    ),
    (
        "logarithms: the Jacobian is that by the parameter itself",
        "blocks *= chain[:, None] * chain",
        "blocks *= 1.0",
        "tests/optimize/test_variable_projection.py -k gram",
    ),
    (
        "covariance without the chain rule",
        "covariance = covariance * scale_products",
        "covariance = covariance * 1.0",
        "tests/optimize/test_identify.py -k 'covariance or straight_line'",
    ),
    (
        "standard errors of white noise, whatever the residual",
        "covariance, _ = penalised_covariance(problem, white, coloured, variance, penalised)",
        "covariance = white",
        "tests/optimize/test_standard_errors.py -k intervals",
    ),
    (
        "the noise of one record alone counts",
        "total += largest * np.real(parts.conj().T @ parts)",
        "total = largest * np.real(parts.conj().T @ parts)",
        "tests/optimize/test_standard_errors.py -k records",
    ),
    (
        "missing samples are taken for noise",
        "return np.maximum(spectrum - self.extra, 0.0) / self.share",
        "return spectrum",
        "tests/optimize/test_standard_errors.py -k jacobians",
    ),
    (
        "the coefficients of disturbances cost no degrees of freedom",
        "n_samples - coefficients.size - root.shape[1]",
        "n_samples - root.shape[1]",
        "tests/optimize/test_identify.py -k 'standard_errors or disturbance'",
    ),
    (
        "a disturbance's coefficients come from the half that they predict",
        "halves = (known, known), (odd & ~known, known | ~odd), (~odd & ~known, known | odd)",
        "halves = (known, known), (odd & ~known, known | odd), (~odd & ~known, known | ~odd)",
        "tests/optimize/test_variable_projection.py -k predictions",
    ),
    (
        "disturbances are eliminated over all records at once",
        "rows = select & (self.segment_record == number)",
        "rows = select & (self.segment_record >= number)",
        "tests/optimize/test_variable_projection.py -k eliminated",
    ),
    (
        "the history before a record that was found is forgotten",
        "    history[: len(best)] = best\n",
        "",
        "tests/optimize/test_input_history.py",
    ),
    (
        "bounds of the user widen those of the model",
        "= max(problem.lower[i], low), min(problem.upper[i], high)",
        "= low, high",
        "tests/optimize/test_methods.py -k bounds",
    ),
    (
        "random starts are forgotten",
        "best = min(found, other, key=lambda pair: pair[1].cost)",
        "best = found",
        "tests/optimize/test_methods.py -k far_start",
    ),
    (
        "Levenberg-Marquardt: the damping rises after a good step",
        "self.value = max(self.value * self.decrease, np.finfo(float).tiny)",
        "self.value = max(self.value / self.decrease, np.finfo(float).tiny)",
        "tests/optimize/test_methods.py -k levenberg",
    ),
    (
        "cuckoo search: Mantegna's scale without its exponent",
        "2.0 ** (0.5 * (_LEVY - 1.0)))\n) ** (1.0 / _LEVY)",
        "2.0 ** (0.5 * (_LEVY - 1.0)))\n)",
        "tests/optimize/test_methods.py -k flights",
    ),
    (
        "cuckoo search: the flight without its exponent",
        "np.abs(rng.normal(size=shape)) ** (1 / _LEVY)",
        "np.abs(rng.normal(size=shape))",
        "tests/optimize/test_methods.py -k flights",
    ),
    (
        "cuckoo search: the nests that are kept are left, and the others kept",
        "discovered = rng.random(shape) < discovery",
        "discovered = rng.random(shape) > discovery",
        "tests/optimize/test_methods.py -k discovered",
    ),
    (
        "cuckoo search: the best nest may be left too",
        "is_discovered[np.argmin(costs)] = False",
        "pass",
        "tests/optimize/test_methods.py -k left_for_a_new",
    ),
    (
        "vector fitting: unstable poles are kept",
        "real = np.minimum(-np.abs(poles.real), -_SLOWEST * np.abs(poles))",
        "real = poles.real",
        "tests/optimize/test_vector_fitting.py",
    ),
    (
        "vector fitting: the weights of the equations are squared",
        "target = _real(block.weight * block.target)",
        "target = _real(block.weight**2 * block.target)",
        "tests/optimize/test_vector_fitting.py",
    ),
]

FAULTS = (
    *_of("models", faults=_MODELS),
    *_of("composition", faults=_COMPOSITION),
    *_of("optimisation", faults=_OPTIMISATION),
    *_of("diagnosis", faults=DIAGNOSIS),
    *_of("diagnosis", "criterion", "tests/diagnosis/test_criterion.py", CRITERION),
)
