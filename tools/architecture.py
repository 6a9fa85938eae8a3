"""Measure the structure of the package: each figure beside its bar, and what misses it by name.

    python tools/architecture.py [--root FOLDER] [--no-profile]

Lines are those of all text files. What is compiled (decorated with `jit`) is left out where bodies
and complexity of functions are judged: a loop over samples is one function because calls would cost
time. Imports are those that run when a module is imported, unless it says otherwise. The calls and
files that a fit passes through are counted by `sys.setprofile` in a fresh process, in the second of
two fits, so that imports and compilation do not count. `--root` measures another checkout.
"""

import argparse
import ast
import json
import os
import re
import statistics
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LAYERS = (  # from the bottom: a module imports from its own layer and those before it
    (
        "__init__",
        "_documentation",
        "_files",
        "_jit",
        "_sklearn",
        "_validation",
        "exceptions",
        "records",
    ),
    ("operators", "persistence"),
    ("optimize",),
    ("base",),
    ("datasets", "metrics", "model_selection"),
    ("preprocessing",),
    ("autoregressive", "disturbance", "fluid", "hysteresis", "linear", "neural", "static"),
    ("compose",),
    ("inspection",),  # the report of a diagnosis is drawn
    ("diagnosis",),
    ("fleet",),
    ("control",),
    ("export",),
    (
        "__main__",
        "app",
        "cli",
        "discovery",
    ),
)
# underscored, and there for every package
SHARED = (
    "skhyst._documentation",
    "skhyst._files",
    "skhyst._jit",
    "skhyst._sklearn",
    "skhyst._validation",
)
LONGEST_BODY = 60  # lines
MOST_COMPLEX = 15
# One search on the plant of `measured_search`, before models became one file each.
CALLS_BEFORE, FILES_BEFORE = 450_170, 73


@dataclass(frozen=True)
class Figure:
    """One measured number, the most that it may be, and what contributes to it."""

    name: str
    value: float
    bar: float
    found: list = field(default_factory=list)

    def __str__(self):
        verdict = "ok" if self.value <= self.bar else "ABOVE"
        lines = [f"{self.name:58s} {self.value:10,.0f} (bar {self.bar:,.0f}) {verdict}"]
        return "\n    ".join(lines + (self.found if self.value > self.bar else []))


def figures(root=ROOT):
    """Return every figure that needs the source alone."""
    modules, tests = read_modules(root / "skhyst"), read_modules(root / "tests")
    sizes = {name: module.n_lines for name, module in modules.items()}
    long = [f"{name}: {size}" for name, size in sizes.items() if size > 500]
    questions = isinstance_calls(modules)
    constants = numeric_constants(modules)

    def counted(name, found, bar=0):
        return Figure(name, len(found), bar, found)

    return [
        Figure("lines of skhyst", lines(root / "skhyst"), 30_000),
        Figure("lines of skhyst.diagnosis", lines(root / "skhyst" / "diagnosis"), 4_000),
        Figure("lines of tests", lines(root / "tests"), 19_000),
        Figure("lines of the median module", statistics.median(sizes.values()), 150),
        Figure("lines of the largest module", max(sizes.values()), 500, long),
        counted("circles of imports", circles(modules)),
        counted("imports of another package's private module", private_imports(modules)),
        counted("imports upwards through the layers", upward_imports(modules)),
        counted("private imports in tests of what is public", tests_of_private(modules, tests)),
        counted(f"functions of more than {LONGEST_BODY} lines", long_functions(modules)),
        counted(f"functions of complexity above {MOST_COMPLEX}", complex_functions(modules)),
        counted("`isinstance` in skhyst.diagnosis", questions, 10),
        counted("named numbers in skhyst.diagnosis, drawing aside", constants, 25),
    ]


def lines(folder):
    """Return the number of lines of all text files below a folder."""
    total = 0
    for path in sorted(folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            try:
                total += path.read_text(encoding="utf-8").count("\n")
            except UnicodeDecodeError:
                continue
    return total


# ---------------------------------------------------------------------------------------------
# Modules and what they import


@dataclass(frozen=True)
class Module:
    """One parsed source file."""

    name: str  # dotted; a package carries its own name, without `__init__`
    is_package: bool
    tree: ast.Module
    n_lines: int

    @property
    def public(self):
        """The names of `__all__`."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                return [item.value for item in node.value.elts if isinstance(item, ast.Constant)]
        return []

    def imports(self, everywhere=False):
        """Yield module and name (None for a whole module) of each import of skhyst."""
        for node in ast.walk(self.tree) if everywhere else outside_functions(self.tree):
            if isinstance(node, ast.Import):
                yield from ((alias.name, None) for alias in node.names if is_own(alias.name))
            elif isinstance(node, ast.ImportFrom):
                source = self._absolute(node)
                if is_own(source):
                    yield from ((source, alias.name) for alias in node.names)

    def _absolute(self, node):
        if not node.level:
            return node.module
        parts = self.name.split(".")
        parts = parts[: len(parts) - node.level + self.is_package]
        return ".".join(parts + ([node.module] if node.module else []))


def is_own(name):
    """Return whether a dotted name is one of skhyst."""
    return name.split(".")[0] == "skhyst"


def outside_functions(tree):
    """Yield the nodes that run when a module is imported."""
    for node in ast.iter_child_nodes(tree):
        for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        if not (for_types or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)):
            yield node
            yield from outside_functions(node)


@cache
def read_modules(folder):
    """Return the modules below a folder by dotted name."""
    modules = {}
    for path in sorted(folder.rglob("*.py")):
        parts = (folder.name, *path.relative_to(folder).with_suffix("").parts)
        is_package = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_package else parts)
        text = path.read_text(encoding="utf-8")
        modules[name] = Module(name, is_package, ast.parse(text), text.count("\n"))
    return modules


def package(name, modules):
    """Return the first folder below skhyst, or "" for a module beside the folders."""
    parts = name.split(".")
    is_folder = len(parts) > 2 or (name in modules and modules[name].is_package)
    return parts[1] if is_folder and len(parts) > 1 else ""


def imported_modules(module, modules):
    """Return the modules that one imports when it is imported itself."""
    found = set()
    for source, name in module.imports():
        found |= {f"{source}.{name}" if f"{source}.{name}" in modules else source}
    return sorted(found & set(modules) - {module.name})


def circles(modules):
    """Return the groups of modules that import one another (Tarjan's components)."""
    index, low, stack, found = {}, {}, [], []

    def visit(name):
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in imported_modules(modules[name], modules):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                found.append(" <-> ".join(sorted(group)))

    for name in modules:
        if name not in index:
            visit(name)
    return found


def private_imports(modules):
    """Return the imports of an underscored module or name of another package, wherever they are."""
    found = []
    for module in modules.values():
        for source, name in module.imports(everywhere=True):
            path = f"{source}.{name}" if name else source
            private = any(re.match(r"_(?!_)", part) for part in path.split("."))  # not __version__
            same = package(source, modules) == package(module.name, modules)
            if private and not same and not {source, path} & set(SHARED):
                found.append(f"{module.name}: {path}")
    return found


def upward_imports(modules):
    """Return the imports of a layer above."""
    ranks = {part: number for number, layer in enumerate(LAYERS) for part in layer}

    def rank(name):
        return ranks[(name.split(".") + ["__init__"])[1]]

    return [
        f"{module.name}: {source}"
        for module in modules.values()
        for source in imported_modules(module, modules)
        if rank(source) > rank(module.name)
    ]


def tests_of_private(modules, tests):
    """Return the imports of private modules in tests for names that a package exports."""
    return [
        f"{test.name}: {source}.{name}, public in {package}"
        for test in tests.values()
        for source, name in test.imports(everywhere=True)
        for package in [source.partition("._")[0]]
        if package != source and package in modules and name in modules[package].public
    ]


# ---------------------------------------------------------------------------------------------
# Functions


def functions(modules):
    """Yield dotted name and node of every function outside compiled code."""
    for module in modules.values():
        yield from functions_below(module.tree, module.name)


def functions_below(node, name):
    """Yield dotted name and node of the functions of a module, a class or a function."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            if not any(is_jit(decorator) for decorator in child.decorator_list):
                yield f"{name}.{child.name}", child
                yield from functions_below(child, f"{name}.{child.name}")
        else:
            below = f"{name}.{child.name}" if isinstance(child, ast.ClassDef) else name
            yield from functions_below(child, below)


def is_jit(decorator):
    """Return whether a decorator compiles: `jit` or `jit(...)`."""
    called = decorator.func if isinstance(decorator, ast.Call) else decorator
    return isinstance(called, ast.Name) and called.id == "jit"


def long_functions(modules):
    """Return the functions whose bodies, docstrings aside, are too long."""
    found = []
    for name, node in functions(modules):
        body = node.body[1:] if ast.get_docstring(node) else node.body
        length = node.end_lineno - body[0].lineno + 1 if body else 0
        if length > LONGEST_BODY:
            found.append(f"{name}: {length} lines")
    return found


def complex_functions(modules):
    """Return the functions with too many paths."""
    paths = {name: complexity(node) for name, node in functions(modules)}
    return [f"{name}: {number}" for name, number in paths.items() if number > MOST_COMPLEX]


def complexity(function):
    """Return McCabe's number of independent paths, counted as ruff's rule C901 does."""
    branches = (ast.If, ast.For, ast.AsyncFor, ast.While, ast.ExceptHandler, ast.match_case)
    nested = (ast.FunctionDef, ast.AsyncFunctionDef)
    number = 0
    for node in ast.walk(function):
        number += isinstance(node, branches + nested)
        number += isinstance(node, ast.Try) and bool(node.orelse)
    return number


def isinstance_calls(modules):
    """Return where skhyst.diagnosis asks for a class."""
    return [
        f"{module.name}: line {node.lineno}"
        for module in of_diagnosis(modules)
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance"
    ]


def numeric_constants(modules):
    """Return the module-level names in capitals of skhyst.diagnosis that hold numbers alone."""
    found = []
    for module in of_diagnosis(modules):
        if module.name.endswith("_figures"):
            continue
        for node in module.tree.body:
            if isinstance(node, ast.Assign) and holds_numbers(node.value):
                names = [leaf.id for target in node.targets for leaf in names_of(target)]
                found += [f"{module.name}.{name}" for name in names if name.isupper()]
    return found


def holds_numbers(value):
    """Return whether an expression has numbers in it and no other constant."""
    leaves = [leaf.value for leaf in ast.walk(value) if isinstance(leaf, ast.Constant)]
    return bool(leaves) and all(type(leaf) in (int, float, complex) for leaf in leaves)


def names_of(target):
    """Return the names that an assignment binds."""
    return [leaf for leaf in ast.walk(target) if isinstance(leaf, ast.Name)]


def of_diagnosis(modules):
    """Return the modules of skhyst.diagnosis."""
    return [m for m in modules.values() if package(m.name, modules) == "diagnosis"]


# ---------------------------------------------------------------------------------------------
# What a fit passes through


def passed_through(fit):
    """Return the Python calls within skhyst, and the files of skhyst, of a fit."""
    folder = os.path.join(os.path.dirname(sys.modules["skhyst"].__file__), "")
    calls, files = 0, set()

    def count(frame, event, _):
        nonlocal calls
        if event == "call" and frame.f_code.co_filename.startswith(folder):
            calls += 1
            files.add(frame.f_code.co_filename[len(folder) :])

    fit()
    sys.setprofile(count)
    try:
        fit()
    finally:
        sys.setprofile(None)
    return calls, sorted(files)


def small_plant():
    """Return drive and response, 2,000 samples, of plays with a lag and a little noise."""
    import numpy as np
    from scipy.signal import lfilter

    rng = np.random.default_rng(0)
    t = 1e-3 * np.arange(2000)
    u = np.sin(2 * np.pi * 3 * t) + 0.5 * np.sin(2 * np.pi * 7.3 * t)
    thresholds, held, path = np.array([0.0, 0.2, 0.5]), np.zeros(3), []
    for value in u:
        held = np.clip(held, value - thresholds, value + thresholds)
        path.append(held.sum())
    pole = np.exp(-1e-3 / 0.02)
    response = lfilter([1 - pole], [1, -pole], path)
    return u[:, None], response + 0.002 * rng.normal(size=2000)


def measured_cascade():
    """Return calls and files of a fit of plays and a lag."""
    from skhyst.compose import Cascade
    from skhyst.hysteresis import PrandtlIshlinskii
    from skhyst.linear import FirstOrderLag

    X, y = small_plant()
    steps = [("hysteresis", PrandtlIshlinskii()), ("lag", FirstOrderLag())]
    return passed_through(lambda: Cascade(steps, dt=1e-3).fit(X, y))


def measured_search():
    """Return calls and files of a search over all effects, for plays that lack the lag."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning

    from skhyst.diagnosis import EffectSearchCV
    from skhyst.hysteresis import PrandtlIshlinskii

    X, y = small_plant()
    search = EffectSearchCV(PrandtlIshlinskii(dt=1e-3), effects="all", random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return passed_through(lambda: search.fit(X, y))


def in_fresh_process(measured, root):
    """Return what a function of this file measures in an interpreter of its own."""
    code = f"import json, architecture as a; print(json.dumps(a.{measured.__name__}()))"
    paths = os.pathsep.join([str(root), str(Path(__file__).parent)])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": paths},
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def profiled_figures(root=ROOT):
    """Return the figures that a fit is run for."""
    _, files = in_fresh_process(measured_cascade, root)
    yield Figure("files that Cascade.fit passes through", len(files), 12, files)
    calls, files = in_fresh_process(measured_search, root)
    yield Figure("calls within skhyst of EffectSearchCV.fit", calls, CALLS_BEFORE / 2)
    yield Figure("files that EffectSearchCV.fit passes through", len(files), FILES_BEFORE / 2)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout that is measured")
    parser.add_argument("--no-profile", action="store_true", help="the source alone, no fits")
    arguments = parser.parse_args()
    root = arguments.root.resolve()
    for figure in figures(root):
        print(figure)
    if not arguments.no_profile:
        for figure in profiled_figures(root):
            print(figure)


if __name__ == "__main__":
    main()
