"""The types that a user's editor sees."""

import ast
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import skhyst

SCRIPT = Path(__file__).with_name("user_script.py")


@pytest.mark.slow
@pytest.mark.skipif(find_spec("pyright") is None, reason="needs pyright (extra lint)")
def test_pyright_knows_what_a_user_writes():
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, str(SCRIPT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_public_module_is_named_to_type_checkers():
    tree = ast.parse(Path(skhyst.__file__).read_text(encoding="utf-8"))
    named = {
        alias.asname
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    }
    assert named == set(dir(skhyst)) - {"__version__"}
