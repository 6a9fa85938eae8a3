"""The snippets of two pages of the user guide run as they stand."""

import re
import textwrap
from pathlib import Path

import pytest

GUIDE = Path(__file__).parents[1] / "docs" / "user_guide"
BLOCK = re.compile(r"\.\. code-block:: python\n\n((?:   .*\n|\n)+)")
OPTIONAL = ("control", "mlflow", "pint_pandas", "polars", "skops.card")


def snippets(page):
    text = (GUIDE / f"{page}.rst").read_text(encoding="utf-8") + "\n"
    return [textwrap.dedent(block) for block in BLOCK.findall(text)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "number"),
    [(page, i) for page in ("model_files", "other_tools") for i in range(1, len(snippets(page)))],
)
@pytest.mark.filterwarnings("ignore:::mlflow", "ignore:::pydantic", "ignore:::skops")
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_a_snippet_runs_after_the_first(page, number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")  # the skinny one has no data base
    monkeypatch.setenv("MLFLOW_TRACKING_URI", (tmp_path / "runs").as_uri())
    first, snippet = snippets(page)[0], snippets(page)[number]
    for name in OPTIONAL:
        if re.search(rf"^(import|from) {re.escape(name)}\b", snippet, re.MULTILINE):
            pytest.importorskip(name)
    exec(compile(f"{first}\n{snippet}", f"{page}.rst", "exec"), {})
