"""What docs/questions.md says is printed, is."""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from impact_xval.compliant_baselines.practical.practices import get_practice, practice_names

PAGE = (Path(__file__).parents[1] / "docs/questions.md").read_text(encoding="utf-8")
IMPORTS, *_ = re.findall(r"```python\n([^`]*)```", PAGE)
SNIPPETS = re.findall(r"```python\n([^`]*)```\n\n```text\n([^`]*)```", PAGE)


@pytest.mark.slow
@pytest.mark.parametrize(("snippet", "printed"), SNIPPETS)
def test_a_snippet_prints_what_the_page_says(snippet, printed):
    for name in practice_names():
        if f'"{name}"' in snippet and (missing := get_practice(name).unavailable()):
            pytest.skip(missing)
    said = StringIO()
    with redirect_stdout(said):
        exec(IMPORTS + snippet, {})
    assert said.getvalue() == printed


def test_every_snippet_has_its_output():
    assert len(SNIPPETS) == PAGE.count("```python") - 1 == PAGE.count("```text") >= 7
