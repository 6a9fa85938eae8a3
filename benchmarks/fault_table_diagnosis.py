"""Faults of the diagnosis, see `fault_table`: name, code, what takes its place, tests."""

DIAGNOSIS = [
    (
        "what is held out is predicted from a fit that has seen it",
        "x = _fold_solution(problem, train, blocks, long)",
        "x = problem.x0",
        "tests/diagnosis/test_candidates.py"
        " tests/diagnosis/test_held_out.py -k 'segment or fold or sample'",
    ),
    (
        "a fold is predicted with the coefficients of its own samples",
        "parts = problem.predictions(x, train, wanted)",
        "parts = problem.predictions(x, test, wanted)",
        "tests/diagnosis/test_candidates.py"
        " tests/diagnosis/test_held_out.py -k 'segment or fold or sample'",
    ),
    (
        "the black box learns from what it is tested on",
        "train = np.flatnonzero(~test)",
        "train = np.flatnonzero(test | True)",
        "tests/diagnosis/test_noise.py -k 'white_noise or noise_is_noise'",
    ),
    (
        "the difference of two repetitions is taken for the noise of one",
        "power += 0.5 * own",
        "power += own",
        "tests/diagnosis/test_noise.py -k repeated",
    ),
    (
        "the first period of a record counts as a repetition",
        "yield i, slice(2 * period, n), i, slice(period, n - period)",
        "yield i, slice(period, n), i, slice(0, n - period)",
        "tests/diagnosis/test_noise.py -k period",
    ),
    (
        "robust loss: lost readings count in full",
        "weights[lost[number]] = 0.0",
        "weights[lost[number]] = 1.0",
        "tests/diagnosis/test_robust.py -k lost",
    ),
    (
        "robust loss: the scale is that of the quiet parts alone",
        "np.maximum(np.median(off), _nearby(off))",
        "np.median(off)",
        "tests/diagnosis/test_robust.py -k structure",
    ),
    (
        "a first part is cut although it shows less than the record",
        "while stop < n and power[stop - 1] < least * known[stop - 1]:",
        "while stop < n and power[stop - 1] < 0.0:",
        "tests/diagnosis/test_shortened.py -k first_part",
    ),
    (
        "a stage more: the intercepts before it are lost",
        "[i].gain * intercept +",
        "[i].gain * 0.0 * intercept +",
        "tests/diagnosis/test_structure.py tests/diagnosis/test_tree.py -k gain",
    ),
    (
        "a schedule by a column reads the column before it",
        "by - 1].mean()",
        "by - 2].mean()",
        "tests/diagnosis/test_starts.py tests/diagnosis/test_declared_models.py -k column",
    ),
    (
        "the place of the residual: shares are not related to their size",
        "return by, record, float(low), float(high), unit, share, share * count / max(size, 1)",
        "return by, record, float(low), float(high), unit, share, share",
        "tests/diagnosis/test_location.py",
    ),
    (
        "spikes: a drive that jumps there and back is no excuse",
        "off &= moved / (np.ptp(u) or 1.0) < 0.3 * height / np.ptp(y)",
        "off &= height > 0.0",
        "tests/diagnosis/test_data_quality.py -k 'physics or pulse'",
    ),
    (
        "lost samples: what moved sides leave need not be what stretches beside leave",
        "found[own] &= drive.left(rows[own], lost) < bound * drive.beside(rows[own])",
        "found[own] &= True",
        "tests/diagnosis/test_data_quality.py -k rough",
    ),
    (
        "a noisy drive: what a slow device does not follow is noise",
        "return floor if _foretold(u, y) < alpha else 0.0",
        "return floor",
        "tests/diagnosis/test_data_quality.py -k rough",
    ),
    (
        "exchanged channels: a response that lags is one that leads",
        "area = np.sign(u @ y)",
        "area = -np.sign(u @ y)",
        "tests/diagnosis/test_data_quality.py -k exchanged",
    ),
    (
        "a set of effects is claimed twice",
        "new = frozenset(better.structure.effects) not in self._claimed",
        "new = True",
        "tests/diagnosis/test_rounds.py -k twice",
    ),
]

CRITERION = [  # of this way to decide
    (
        "a resonance without a peak is let through, whatever its margin",
        "return min(margin, shows - np.log1p(NOTICEABLE))",
        "return margin",
        "tests/diagnosis/test_effects.py tests/diagnosis/test_plausibility.py -k peak",
    ),
    (
        "a mode that has become another counts as a further one",
        "return ringing[0] <= ringing[1]",
        "return ringing[0] < ringing[1]",
        "tests/diagnosis/test_plausibility.py -k place",
    ),
    (
        "blocks have the length one always",
        "length = min(max(length, 1), longest)\n    return",
        "length = 1\n    return",
        "",
    ),
    (
        "the variance that blocks miss is not put back",
        "spread = np.sqrt(sums @ sums / (1.0 - missing))",
        "spread = np.sqrt(sums @ sums)",
        "",
    ),
    (
        "the gain is not halved",
        "return block_p_value(0.5 * gain, chances)",
        "return block_p_value(gain, chances)",
        "",
    ),
    (
        "min_improvement is ignored",
        "factor = 1.0 - self.min_improvement",
        "factor = 1.0",
        "",
    ),
    (
        "a fall of the error in the fit is not asked for",
        "return bool(lower and better.cost < factor**2 * worse.cost)",
        "return bool(lower)",
        "",
    ),
    (
        "no correction for many candidates that were tried",
        "return min(1.0, n_tried * p)",
        "return min(1.0, p)",
        "",
    ),
    (
        "chance is told by the residuals of the worse model",
        "chances.append(w * (a - b) * b)",
        "chances.append(w * (a - b) * a)",
        "",
    ),
    (
        "weights have no part in the gain",
        "gain += np.sum(w * (a - b) * (a + b))",
        "gain += np.sum((a - b) * (a + b))",
        "",
    ),
    (
        "as many degrees of freedom as samples",
        "float(student.sf(total / spread, len(sums)))",
        "float(student.sf(total / spread, sum(map(len, chances))))",
        "",
    ),
    (
        "models that describe equally well are told apart",
        "return bool(lower) and self.p_value(worse, better, n_tried) < self.alpha",
        "return bool(lower)",
        "",
    ),
    (
        "the threshold of structure times ten, in parts of the error",
        "return bool(self.p_value < criterion.alpha and self.share <= most)",
        "return bool(self.p_value < criterion.alpha and self.share <= most**10)",
        "tests/diagnosis/test_noise.py -k structure",
    ),
    (
        "pairs are not counted among what was tried",
        "n_tried = max(self._n_tried, 2 * comb(len(effects), 2))",
        "n_tried = 1",
        "tests/diagnosis/test_rounds.py tests/diagnosis/test_search_options.py -k pairs",
    ),
    (
        "a model that foretells badly leaves noise",
        'self.verdict_ = "undetermined"',
        'self.verdict_ = "noise"',
        "tests/diagnosis/test_effect_search.py -k determine",
    ),
    (
        "a mode above half the sampling rate is let through",
        "np.log(highest / (mode * (1.0 + ratio)))",
        "np.inf",
        "tests/diagnosis/test_effects.py -k peak",
    ),
    (
        "a pair is claimed that is no better than a part of it",
        "if self._is_better(base, c) and self._needs_all(c)]",
        "if self._is_better(base, c)]",
        "tests/diagnosis/test_rounds.py tests/diagnosis/test_search_options.py -k 'two or pair'",
    ),
    (
        "what was estimated from a held-out record counts as foretold",
        "own *= np.sqrt((n + k) / max(n - k, 1))",
        "own *= 1.0",
        "tests/diagnosis/test_candidates.py -k estimated",
    ),
    (
        "a drift's constant counts as a drift",
        "if disturbance.has_constant and own.shape[1] > 1:",
        "if disturbance.has_constant and own.shape[1] > 99:",
        "tests/diagnosis/test_course.py -k constant",
    ),
    (
        "an effect may take over what another was",
        "if not self._needs(base, reduced) and self._keeps_names(reduced.structure):",
        "if not self._needs(base, reduced):",
        "tests/diagnosis/test_timing.py",
    ),
]
