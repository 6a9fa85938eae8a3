"""Each promise of the documentation names tests, and they are there."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_promise_has_its_tests():
    text = (ROOT / "docs" / "promises.rst").read_text(encoding="utf-8")
    promises = re.split(r"\n(?=\*\*)", text)[1:]
    assert promises
    for promise in promises:
        named = re.findall(r"`(tests/\S+?)::(\w+)`", promise)
        assert named, promise
        for path, name in named:
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            tests = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
            assert name in tests, f"{path}::{name}"
