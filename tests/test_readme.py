"""What the README shows runs as it stands, and the extras are those that there are."""

import re
import tomllib
from pathlib import Path

import pytest
from joblib import parallel_config

from skhyst.cli._demo_recording import SECRETS, make_demo_recording
from skhyst.diagnosis import EFFECTS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_five_lines_on_the_recording_of_the_demo(tmp_path, monkeypatch, capsys):
    pytest.importorskip("jinja2", reason="the report needs the extra plot")
    table, effect, _ = make_demo_recording(0, n_records=2)
    (tmp_path / "skhyst_demo").mkdir()
    table[::2].to_csv(tmp_path / "skhyst_demo" / "recording.csv", index=False)
    code = re.search(r"## Five lines\n\n```python\n(.*?)```", README, re.DOTALL)[1]
    monkeypatch.chdir(tmp_path)
    few = {name: EFFECTS[name] for name in SECRETS}  # of all, those that the demo may hide
    monkeypatch.setattr("skhyst.diagnosis._effects.EFFECTS", few)
    with parallel_config("threading"):  # processes would begin with the imports
        exec(code, {})
    assert effect in capsys.readouterr().out
    assert "<html" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_what_the_readme_links_to_is_there():
    linked = re.findall(r"\]\(([^)#:]+)\)", README)
    assert linked
    assert [path for path in linked if not (ROOT / path).exists()] == []


def test_extras_are_told_the_same_everywhere():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "install.rst").read_text(encoding="utf-8")
    shown = re.findall(r"^\| (`[^|]+`) \| (.+) \|$", README.partition("## Extras")[2], re.MULTILINE)
    listed = re.findall(r"^   \* - (`.+)\n     - (.+)$", page, re.MULTILINE)
    extras = declared["project"]["optional-dependencies"]
    assert listed == [row for row in shown if not row[0].startswith("`skhyst.")]
    assert sorted(re.findall(r"`(\w+)`", " ".join(row[0] for row in listed))) == sorted(extras)
