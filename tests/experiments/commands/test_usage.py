"""What is typed wrongly, and how help is reached: one line that names the command and the option."""

import typer

from impact_xval.experiments.commands.cli import FORMER, app, main

COMMANDS: list[str] = sorted(vars(typer.main.get_command(app))["commands"])


def test_both_words_for_help_are_legal_everywhere(capsys):
    for command in ([], *([name] for name in COMMANDS)):
        shown = []
        for word in ("-h", "--help"):
            assert main([*command, word]) == 0, command
            shown.append(capsys.readouterr().out)
        assert shown[0] == shown[1]
        assert shown[0].startswith(" ".join(["Usage: impact-xval", *command]))
        assert shown[0].count("\n") <= 40
        assert not command or "Example: impact-xval " + command[0] in shown[0]


def test_former_names_say_what_there_is_instead(capsys):
    for name, instead in FORMER.items():
        assert main([name, "x"]) == 2
        assert (
            capsys.readouterr().err
            == f"impact-xval: {name}: of an earlier version; now: impact-xval {instead}\n"
        )


def test_a_usage_error_names_the_command_whose_help_is_meant(capsys):
    for arguments, says, command in (
        (["run", "--no-such-option"], "No such option: --no-such-option.", "impact-xval run"),
        (["contact", "--masses", "1", "1"], "Missing option '--engine'.", "impact-xval contact"),
        (["solve", "--e1", "1", "--e2"], "Option '--e2' requires an argument.", "impact-xval solve"),
        (["show", "a", "b"], "Got unexpected extra argument(s) (b).", "impact-xval show"),
        (["no-such-command"], "No such command 'no-such-command'.", "impact-xval"),
    ):
        assert main(arguments) == 2
        said = capsys.readouterr().err.replace("argument (b)", "argument(s) (b)")  # older versions of typer
        assert said == f"impact-xval: {says} Try '{command} --help'.\n"
