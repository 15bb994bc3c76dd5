"""What a terminal would obey is shown, wherever a text of a file or a user is."""

import pytest

from impact_xval.compliant_baselines.contract.visible import visible
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.presentation.page.html import html_of
from impact_xval.experiments.presentation.pages import latex_of, render


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31mred\x07", r"\x1b[31mred\x07"),
        ("\x9b2J\x7f\x00", r"\x9b2J\x7f\x00"),
        ("a\u202eb\u2066c\u200fd", r"a\u202eb\u2066c\u200fd"),
        ("a\rb\x0b\u2028\ud800", r"a\rb\x0b\u2028\ud800"),
        ("Größe µ\u00a0→ 漢字\n\t✓", "Größe µ\u00a0→ 漢字\n\t✓"),
    ],
)
def test_what_is_shown(text, shown):
    assert visible(text) == shown
    assert visible(shown) == shown


def test_an_error_and_a_page_show_it():
    assert str(UserError("a\x1b[2Jb\nc")) == r"a\x1b[2Jb c"
    page = render("solvers.md.j2", rows=[("\x1b[2J\u202e", "", "", "", "")])
    for text in (page, html_of(page, "t"), latex_of(page)):
        assert not any(letter in text for letter in "\x1b\u202e")


@pytest.mark.parametrize("command", ["run", "table", "doctor", "status", "--\x1b[2J"])
def test_a_file_name_is_shown_on_the_terminal(command, tmp_path, capsys):
    assert main([command, str(tmp_path / "a\x1b[2Jb.xml")]) in (1, 2)
    captured = capsys.readouterr()
    assert r"\x1b[2J" in captured.err + captured.out
    assert "\x1b" not in captured.err + captured.out
