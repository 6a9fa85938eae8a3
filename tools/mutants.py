"""Mutants: random mistakes in decisions and in compiled loops.

A mutant changes one operator, comparison, condition, extremum or number in the body of a function
of `skhyst.diagnosis` and the modules it is based on, or of a compiled function of the operators and
models. Left out are changes that only affect the words of a message or tolerances of rounding, and
`<` for `<=`, which changes nothing on measured numbers. Numbers at the top of a module are
settings: `fault_table` has those with a theorem.

Not mutmut: it selects the mutant in a Python function around those of each file, which compiled
code cannot call, and so leaves out decorated functions and classes: all loops, all operators. Not
cosmic-ray: it has one test command for all mutants, each with its imports and its compilation
again.
"""

import ast
import random
from dataclasses import dataclass

from fault_table import Fault

__all__ = ["draw_mutants", "edits"]

_OPERATORS = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Pow: ("**", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
_NAMES = {
    **{
        f"{nan}{a}": f"{nan}{b}" for nan in ("", "nan") for a, b in (("min", "max"), ("max", "min"))
    },
    **{"minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin"},
    **{"any": "all", "all": "any", "floor": "ceil", "ceil": "floor"},
}
_WORDS = (ast.Raise, ast.Assert, ast.JoinedStr, ast.List)  # a list plus a list has no difference
_ROUNDING = 1e-5  # numbers below, and above its inverse, keep from dividing by zero

_DECISIONS = {  # module, of the diagnosis where no folder is named: tests, the quickest first
    "_black_box": "test_black_box test_noise",
    "_candidates": "test_candidates test_shortened test_initial_state test_reference "
    "test_search_options",
    "_changes": "test_changes test_tree test_further_forms test_effects test_declared_models "
    "test_moved_modes",
    "_claim": "test_decision test_evidence test_timing test_stages",
    "_course": "test_course test_plausibility",
    "_criterion": "test_criterion test_decision",
    "_edits": "test_tree test_course test_starts test_candidates",
    "_location": "test_location",
    "_next_experiment": "test_next_experiment",
    "_structure": "test_noise test_reference test_verdict",
    "_verdict": "test_noise test_verdict",
    "_open_questions": "test_open_questions test_next_experiment test_evidence",
    "_plausibility": "test_plausibility test_effects test_moved_modes",
    "_reference": "test_reference",
    "_robust": "test_robust",
    "_contest": "test_contest test_decision test_search_options test_timing test_stages "
    "test_invariance",
    "_shortened": "test_shortened test_candidates",
    "_starts": "test_starts test_declared_models test_rate_dependence",
    "_tree": "test_tree test_candidates test_starts",
    "records/_periods": "test_noise test_plausibility test_small_decisions",
    "records/_channels": "test_channels test_data_quality test_reference",
    "records/_data_quality": "test_data_quality test_robust",
    "noise/_model": "test_model",
    "noise/_block_test": "test_small_decisions test_block_test",
    "noise/_differences": "test_differences test_channels",
}
_KERNELS = {  # module: tests beside those of the same name, names in the suite of all operators
    "hysteresis/_bouc_wen": ("", "Bouc-Wen and not stage"),
    "hysteresis/_bouc_wen_stage": ("", "Bouc-Wen and stage"),
    "hysteresis/_coulomb_friction": ("test_friction", "Coulomb"),
    "hysteresis/_dahl": ("test_friction test_one_state", "Dahl"),
    "hysteresis/_duhem": ("", "Duhem"),
    "hysteresis/_end_stops": ("test_oscillator", "end and stop"),
    "hysteresis/_friction_stage": ("test_oscillator", "friction and stage"),
    "hysteresis/_jiles_atherton": ("", "Jiles"),
    "hysteresis/_krasnoselskii_pokrovskii": ("test_relay_grid", "ramps"),
    "hysteresis/_lugre": ("test_friction", "LuGre"),
    "hysteresis/_maxwell_slip": ("test_friction", "slip"),
    "hysteresis/_oscillator": ("test_bouc_wen_stage", "Bouc-Wen and stage"),
    "hysteresis/_preisach": ("test_superpositions test_relay_grid", "relays"),
    "hysteresis/_rate_dependent_prandtl_ishlinskii": ("", "rate-dependent"),
    "hysteresis/_restoring_force": ("test_oscillator", "restoring"),
    "hysteresis/_system_level": ("", "system and level"),
    "hysteresis/_tanh": ("", "tanh"),
    "hysteresis/_slew_limit": ("test_one_state", "slew"),
    "hysteresis/_backlash": ("test_one_state", "backlash"),
    "linear/_dynamic_stiffness": ("", "dynamic and stiffness"),
    "linear/_interpolation": ("test_linear", "shift or clocks or delay"),
    "linear/_log_creep": ("", "creep and logarithmic"),
    "linear/_time_shift": ("test_linear", "shift or clocks"),
    "operators/_slopes": ("", "delay or mode or series"),
    "operators/_linear_inverse": ("test_inverse", "mode"),
    "operators/_one_state": ("", "Dahl or tanh"),
    "operators/_plays": ("test_prandtl_ishlinskii", "plays and not rate-dependent"),
    "operators/_products": ("test_identify test_variable_projection", "mode"),
    "operators/_state_space": ("test_linear test_hold", "lag or mode or transfer"),
    "operators/_window_inverse": ("test_inverse", "mode"),
}
_LOOPS = {"run", "tangents", "compiled_step", "sample"}  # compiled for the law of each model


@dataclass(frozen=True)
class _Edit:
    """A piece of a file and what takes its place."""

    begin: int
    end: int
    faulty: str


def draw_mutants(texts, count, seed=0):
    """Draw mutants from what a package says.

    Parameters
    ----------
    texts : dict of path to str
        The files of the package.
    count : int
        Number of mutants, half of them in decisions, half in compiled loops.
    seed : int, default=0

    Returns
    -------
    list of Fault
    """
    rng, found = random.Random(seed), []
    for area, tests in ("decisions", _decision_tests), ("loops", _loop_tests):
        pool = [
            (path, edit, tests(path))
            for path, text in texts.items()
            if tests(path)
            for edit in edits(text, area == "loops")
        ]
        for path, edit, arguments in rng.sample(pool, min(count // 2, len(pool))):
            found.append(_fault(area, texts, path, edit, arguments))
    return found


def _decision_tests(path):
    folder, names = path.parent.name, []
    key = f"{folder}/{path.stem}".removeprefix("diagnosis/")
    if key not in _DECISIONS:
        return ""
    if folder == "diagnosis":
        names = [f"diagnosis/{name}" for name in ("test_small_decisions", *_DECISIONS[key].split())]
    else:
        names = [f"**/{name}" for name in _DECISIONS[key].split()]
    files = " ".join(f"tests/{name}.py" for name in names)
    return f"{files} skhyst/{folder}/{path.name}".replace("skhyst/skhyst/", "skhyst/")


def _loop_tests(path):
    key = f"{path.parent.name}/{path.stem}"
    if key not in _KERNELS:
        return ""
    more, words = _KERNELS[key]
    own = "test" + path.stem
    names = dict.fromkeys([own, *more.split()])
    files = " ".join(f"tests/**/{name}.py" for name in names)
    files += f" skhyst/{key}.py"  # the examples of its docstrings
    return f"tests/operators/test_acceptance.py {files} -k 'not test_acceptance or ({words})'"


def _fault(area, texts, path, edit, tests):
    """Return an edit as a fault: the shortest lines around it that the package says once."""
    text = texts[path]
    begin = text.rfind("\n", 0, edit.begin) + 1
    end = text.find("\n", edit.end)
    name = f"{path.parent.name}/{path.name}:{text.count(chr(10), 0, begin) + 1}: "
    name += f"{text[begin:end].strip()} -> {edit.faulty} at {edit.begin - begin}"
    while sum(other.count(text[begin:end]) for other in texts.values()) > 1:
        begin = text.rfind("\n", 0, max(begin - 1, 0)) + 1
        end = max(text.find("\n", end + 1), end)
    faulty = text[begin : edit.begin] + edit.faulty + text[edit.end : end]
    return Fault(name, area, text[begin:end], faulty, tests)


def edits(text, compiled=False):
    """Return all edits of the functions of a file.

    Parameters
    ----------
    text : str
    compiled : bool, default=False
        Of compiled functions alone.

    Returns
    -------
    list of edits, with the attributes ``begin``, ``end`` and ``faulty``
    """
    tree, starts = ast.parse(text), [0]
    for line in text.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    chosen = _compiled(tree) if compiled else None
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and (chosen is None or node.name in chosen):
            for statement in node.body:
                found += _Finder(text.encode(), starts).of(statement)
    return sorted(set(found), key=lambda edit: (edit.begin, edit.faulty))


def _compiled(tree):
    """Return the names of the functions that are compiled."""
    names = set(_LOOPS)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            names |= {node.name for mark in node.decorator_list if "jit" in ast.unparse(mark)}
        if isinstance(node, ast.ClassDef):
            names |= {word.value.id for word in node.keywords if word.arg == "step"}
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "bind":
            names |= {arg.id for arg in node.args if isinstance(arg, ast.Name)}
    return names


class _Finder:
    """The edits of a statement, whose places are told in bytes of the file."""

    def __init__(self, source, starts):
        self._source, self._starts = source, starts

    def of(self, node):
        if isinstance(node, _WORDS) or (isinstance(node, ast.Call) and _warns(node)):
            return []
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):  # a docstring
            return []
        if isinstance(node, ast.keyword) and node.arg == "strict":  # lengths are equal anyway
            return []
        if isinstance(node, ast.FunctionDef):  # its defaults and annotations stay
            return [edit for child in node.body for edit in self.of(child)]
        found = list(self._own(node))
        for child in ast.iter_child_nodes(node):
            found += self.of(child)
        return found

    def _own(self, node):
        if isinstance(node, ast.BinOp):
            yield from self._between(node.left, node.op, node.right)
        elif isinstance(node, ast.AugAssign):
            yield from self._between(node.target, node.op, node.value)
        elif isinstance(node, ast.BoolOp):
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from self._between(left, node.op, right)
        elif isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
            for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
                yield from self._between(left, operator, right)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            begin, old = self._begin(node), 3 if isinstance(node.op, ast.Not) else 1
            yield self._edit(begin, begin + old, "" if old == 3 else "+")
        elif isinstance(node, ast.Break | ast.Continue):
            other = "continue" if isinstance(node, ast.Break) else "break"
            yield self._edit(self._begin(node), self._end(node), other)
        elif isinstance(node, ast.Constant):
            yield from self._constant(node)
        elif isinstance(node, ast.Call):
            yield from self._name(node.func)

    def _between(self, left, operator, right):
        if any(isinstance(side, _WORDS) or _is_text(side) for side in (left, right)):
            return
        old, new = _OPERATORS.get(type(operator), ("", ""))
        begin, end = self._end(left), self._begin(right)
        at = self._source[begin:end].find(old.encode()) if old else -1
        if at >= 0:
            yield self._edit(begin + at, begin + at + len(old), new)

    def _constant(self, node):
        value = node.value
        if isinstance(value, bool):
            yield self._edit(self._begin(node), self._end(node), str(not value))
        elif isinstance(value, int | float) and (
            value == 0 or _ROUNDING < abs(value) < 1.0 / _ROUNDING
        ):
            new = type(value)(1) if value == 0 else 2 * value
            yield self._edit(self._begin(node), self._end(node), repr(new))

    def _name(self, node):
        name = node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")
        if name in _NAMES:
            yield self._edit(self._end(node) - len(name), self._end(node), _NAMES[name])

    def _begin(self, node):
        return self._starts[node.lineno - 1] + node.col_offset

    def _end(self, node):
        return self._starts[node.end_lineno - 1] + node.end_col_offset

    def _edit(self, begin, end, faulty):
        """Return an edit whose places are told in characters."""
        return _Edit(len(self._source[:begin].decode()), len(self._source[:end].decode()), faulty)


def _warns(node):
    return ast.unparse(node.func) == "warnings.warn"


def _is_text(node):
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
