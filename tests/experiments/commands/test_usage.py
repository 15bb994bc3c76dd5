"""What is typed wrongly, and how help is reached: one line that names the command and the option."""

import typer

from impact_xval.experiments.commands.cli import app, main

COMMANDS: list[str] = sorted(vars(typer.main.get_command(app))["commands"])


def test_both_words_for_help_are_legal_everywhere(capsys):
    for command in ([], *([name] for name in COMMANDS)):
        shown = []
        for word in ("-h", "--help"):
            assert main([*command, word]) == 0, command
            shown.append(capsys.readouterr().out)
        assert shown[0] == shown[1]
        assert shown[0].startswith(" ".join(["Usage: impact-xval", *command]))


def test_a_usage_error_names_the_command_whose_help_is_meant(capsys):
    for arguments, says, command in (
        (["run", "--no-such-option"], "No such option: --no-such-option.", "impact-xval run"),
        (["solve", "--mass-ratio", "1"], "Missing option '--stiffness-ratio'.", "impact-xval solve"),
        (["solve", "--e1", "1", "--e2"], "Option '--e2' requires an argument.", "impact-xval solve"),
        (["status", "a", "b"], "Got unexpected extra argument(s) (b).", "impact-xval status"),
        (["no-such-command"], "No such command 'no-such-command'.", "impact-xval"),
    ):
        assert main(arguments) == 2
        said = capsys.readouterr().err.replace("argument (b)", "argument(s) (b)")  # older versions of typer
        assert said == f"impact-xval: {says} Try '{command} --help'.\n"
