"""The list of benchmarks names each command, and nothing else."""

import re

from architecture import ROOT


def test_each_command_has_its_line():
    folder = ROOT / "benchmarks"
    text = (folder / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"`(\w+\.py)`", "".join(re.findall(r"^- .*$", text, re.MULTILINE)))
    commands = [path.name for path in folder.glob("*.py") if "\nif __name__ ==" in path.read_text()]
    assert sorted(listed) == sorted(commands)
