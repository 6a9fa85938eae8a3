"""Measure the structure of the package: each figure with its limit, and names that exceed it.

    python tools/architecture.py [--root FOLDER] [--no-profile]

Imports are those that run when a module is imported, unless it says otherwise. The calls and files
that a fit passes through are counted by `sys.setprofile` in a fresh process, in the second of two
fits, so that imports and compilation do not count. Lines are those of all text files, by package,
for comparison; they have no limit. `--root` measures another checkout.
"""

import argparse
import ast
import json
import os
import re
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
        "_envelope",
        "_files",
        "_jit",
        "_progress",
        "_sizes",
        "_sklearn",
        "exceptions",
    ),
    ("noise",),
    ("io",),
    ("records", "_validation"),
    ("operators", "_signals"),
    ("optimize",),
    ("datasets", "metrics", "model_selection", "persistence"),
    ("preprocessing",),
    ("base",),
    ("hysteresis", "linear", "static", "disturbance", "fluid", "autoregressive", "neural"),
    ("compose",),
    ("fleet",),
    ("inspection",),  # the report of a search is drawn
    ("diagnosis",),
    ("control",),
    ("export",),
    ("discovery",),
    ("__main__", "app", "cli"),
)
# underscored, and there for every package
SHARED = (
    "skhyst._documentation",
    "skhyst._envelope",
    "skhyst._files",
    "skhyst._jit",
    "skhyst._progress",
    "skhyst._sizes",
    "skhyst._sklearn",
    "skhyst._signals",
    "skhyst._validation",
)
# Calls within skhyst of one fit, with compositions in two trees: of models and of operators
CASCADE_BEFORE, SEARCH_BEFORE = 20_999, 150_567


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
    examples = read_modules(root / "examples")

    def none(name, found):
        return Figure(name, len(found), 0, found)

    return [
        none("circles of imports", circles(modules)),
        none("imports of another package's private module", private_imports(modules)),
        none("imports upwards through the layers", upward_imports(modules)),
        none("private imports in tests of what is public", tests_of_private(modules, tests)),
        none("shared names that no other package uses", unused_shared(modules)),
        none("imports in examples of what is not public", not_public(modules, examples)),
    ]


def lines(folder):
    """Return the number of lines of all text files below a folder, or of one file."""
    total = 0
    for path in sorted(folder.rglob("*")) if folder.is_dir() else [folder]:
        if path.is_file() and "__pycache__" not in path.parts:
            try:
                total += path.read_text(encoding="utf-8").count("\n")
            except UnicodeDecodeError:
                continue
    return total


def lines_by_package(root=ROOT):
    """Return lines and name of each package of skhyst, the longest first, and of the folders."""
    parts = [path for path in (root / "skhyst").iterdir() if path.name != "__pycache__"]
    found = sorted(((lines(path), f"skhyst/{path.name}") for path in parts), reverse=True)
    others = ("skhyst", "tests", "examples", "docs", "benchmarks", "tools")
    return found + [(lines(root / name), name) for name in others if (root / name).exists()]


# ---------------------------------------------------------------------------------------------
# Modules and what they import


@dataclass(frozen=True)
class Module:
    """One parsed source file."""

    name: str  # dotted; a package carries its own name, without `__init__`
    is_package: bool
    tree: ast.Module

    @property
    def public(self):
        """The names of `__all__`."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                return [item.value for item in node.value.elts if isinstance(item, ast.Constant)]
        return []

    @property
    def shared(self):
        """The names that a package imports ``as`` themselves: other packages may use them."""
        found = [node for node in self.tree.body if isinstance(node, ast.ImportFrom)]
        names = [alias for node in found for alias in node.names]
        return [alias.name for alias in names if alias.asname == alias.name]

    @cache  # noqa: B019  (the process is short)
    def imports(self, everywhere=False):
        """Return module and name (None for a whole module) of each import of skhyst."""
        found = []
        for node in statements(self.tree, everywhere):
            if isinstance(node, ast.Import):
                found += [(alias.name, None) for alias in node.names if is_own(alias.name)]
            elif isinstance(node, ast.ImportFrom):
                source = self._absolute(node)
                if is_own(source):
                    found += [(source, alias.name) for alias in node.names]
        return found

    def _absolute(self, node):
        if not node.level:
            return node.module
        parts = self.name.split(".")
        parts = parts[: len(parts) - node.level + self.is_package]
        return ".".join(parts + ([node.module] if node.module else []))


def is_own(name):
    """Return whether a dotted name is one of skhyst."""
    return name.split(".")[0] == "skhyst"


def statements(node, everywhere):
    """Yield the statements in a node: all, or those that run when a module is imported."""
    for own in ast.iter_child_nodes(node):
        if not isinstance(own, ast.stmt | ast.ExceptHandler | ast.match_case):
            continue  # no expression imports
        for_types = isinstance(own, ast.If) and ast.unparse(own.test) == "TYPE_CHECKING"
        if everywhere or not (for_types or isinstance(own, ast.FunctionDef | ast.AsyncFunctionDef)):
            yield own
            yield from statements(own, everywhere)


@cache
def read_modules(folder):
    """Return the modules below a folder by dotted name."""
    modules = {}
    for path in sorted(folder.rglob("*.py")):
        parts = (folder.name, *path.relative_to(folder).with_suffix("").parts)
        is_package = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_package else parts)
        modules[name] = Module(name, is_package, ast.parse(path.read_text(encoding="utf-8")))
    return modules


def package(name, modules):
    """Return the first folder below skhyst, or "" for a module outside the folders."""
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


def unused_shared(modules):
    """Return the names that a package shares or lists twice, or that no other package imports."""
    used = {
        (source, name)
        for module in modules.values()
        for source, name in module.imports(everywhere=True)
        if package(source, modules) != package(module.name, modules)
    }
    return [
        f"{module.name}.{name}"
        for module in modules.values()
        for name in module.shared
        if name in module.public or (module.name, name) not in used
    ]


def not_public(modules, users):
    """Return the imports of names that are not public."""
    return [
        f"{user.name}: {source}.{name}"
        for user in users.values()
        for source, name in user.imports(everywhere=True)
        if name and f"{source}.{name}" not in modules and name not in modules[source].public
    ]


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
    """Return the result of a function of this file in a fresh interpreter."""
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
    for name, measured, most_calls, most_files in (
        ("Cascade.fit", measured_cascade, CASCADE_BEFORE / 2, 12),
        ("EffectSearchCV.fit", measured_search, SEARCH_BEFORE, 40),
    ):
        calls, files = in_fresh_process(measured, root)
        yield Figure(f"calls within skhyst of {name}", calls, most_calls)
        yield Figure(f"files that {name} passes through", len(files), most_files, files)


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
    for number, name in lines_by_package(root):
        print(f"{number:8,d} lines  {name}")


if __name__ == "__main__":
    main()
