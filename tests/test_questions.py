"""The answers of docs/questions.md: every command works, and prints what stands there."""

import re
from pathlib import Path

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.commands.cli import main

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/questions.md").read_text(encoding="utf-8")
ANSWERS = re.findall(r"^## (\d+)\. .*?\n```(sh|python)\n(.*?)```\n\n```text\n(.*?)```", PAGE, re.M | re.S)

#: Solvers that not every machine has.
OPTIONAL = ("dart", "pymunk", "rapier", "sapien", "pybullet", "newton")

#: A number that is no part of a word.
NUMBER = r"(?<![\w.])-?\d+\.?\d*(?:e[+-]?\d+)?(?![\w.])"


def test_fifteen_questions_have_an_answer_each_and_a_thread():
    assert [int(number) for number, *_ in ANSWERS] == list(range(1, 16))
    threads = r"^## \d+\. .* \(\[.*\]\(https://github.com/.*/(issues|pull)/\d+\)\)$"
    assert len(re.findall(threads, PAGE, re.M)) == 15


@pytest.mark.slow
@pytest.mark.parametrize(("language", "commands", "shown"), [answer[1:] for answer in ANSWERS])
def test_a_command_prints_what_the_page_shows(language, commands, shown, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    asked = commands.replace("newton-restitution", "")  # a law, not the engine
    missing = [name for name in OPTIONAL if name in asked and get_solver(name).unavailable()]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")
    if language == "python":
        from impact_xval.compliant_baselines.rigid.lines import RigidWorld

        monkeypatch.setattr(RigidWorld, "partner", 1.0)  # which the code sets
        exec(commands, {})
    else:
        for command in commands.replace("\\\n", "").splitlines():
            assert main(command.split()[1:]) in (0, 3), command
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    for line in shown.splitlines():
        assert any(_alike(line.split(), words) for words in printed), line


def _alike(one, two):
    """Whether lines have the same words, and numbers within 1 %, or 1e-5."""
    words = [[re.sub(NUMBER, "#", word) for word in line] for line in (one, two)]
    numbers = [[float(each) for each in re.findall(NUMBER, " ".join(line))] for line in (one, two)]
    return words[0] == words[1] and numbers[0] == pytest.approx(numbers[1], rel=1e-2, abs=1e-5)
