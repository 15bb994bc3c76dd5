"""What is typed wrongly, and how help is reached: one line that names the command and the option."""

import pytest
import typer

from impact_xval.experiments.commands.cli import app, main

COMMANDS: list[str] = sorted(vars(typer.main.get_command(app))["commands"])

BESIDE = "solve --stiffness-ratio 1 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --solver kelvin-voigt"
PLOT = "legal: a file that ends in .png, .svg, .pdf, .gif, .html"
ASK = "contact --engine mujoco --masses 1.0 0.5 --restitution 0.7"
STEEL = "contact --engine mujoco --material steel"
#: What is typed, and what the line holds.
WRONG = [
    ("run --no-such-option", "No such option: --no-such-option. Try 'impact-xval run --help'."),
    ("contact --masses 1 1", "Missing option '--engine'. Try 'impact-xval contact --help'."),
    ("solve --e1 1 --e2", "Option '--e2' requires an argument. Try 'impact-xval solve --help'."),
    ("show a b", "(b). Try 'impact-xval show --help'."),
    ("no-such-command", "No such command 'no-such-command'. Try 'impact-xval --help'."),
    *(
        (f"run --shard {x}", f"--shard = {x!r}; legal: I/N, I from 1 to N")
        for x in ("0/4", "5/4", "1/0", "1")
    ),
    ("run --workers 0", "--workers = '0'; legal: a whole number from 1 to 4096"),
    ("report a --only all", "--only = 'all'; legal: page, tables, figures"),
    ("scene a b", "N = 'b'; legal: a whole number"),
    ("scene a", "a: a cell of a run is named by its number alone"),
    ("run my.toml --quick", "--quick with my.toml: it is for the built-in grid; legal: one of both"),
    ("scoreboard --solver mujocco", "--solver 'mujocco' is not a solver (did you mean 'mujoco'?)"),
    ("scoreboard --baseline nowhere", "--baseline = nowhere: holds no answers.parquet of a scoreboard"),
    ("solvers --law bistiffness", "--law = 'bistiffness' without NAME; legal: beside the solver"),
    ("solvers bullet", "NAME 'bullet' is not a solver (did you mean 'pybullet'?); legal: state-transition"),
    (f"{BESIDE} --plot one.avi", f"--plot = 'one.avi'; {PLOT}"),
    (f"{BESIDE} --plot folder.png", f"--plot = 'folder.png'; {PLOT}"),
    (f"{BESIDE} --plot there/one.gif", "--plot = 'there/one.gif': no folder there"),
    *((f"inspect any.xml --speed={x}", "--speed = ") for x in ("0", "-1", "inf", "nan", "fast")),
    ("inspect gone.xml", "gone.xml: no such file of MuJoCo; legal: a file that ends in .xml or .mjb"),
    (f"{ASK} --stiffness 1 --restitution 0", "--restitution = 0.0; legal: from 0.0001 to 1"),
    (f"{ASK} --stiffness 1 --restitution half", "--restitution = 'half'; legal: a number"),
    (f"{ASK} --stiffness 1 --masses 1 --restitution", "--masses = '--restitution'; legal: a number"),
    (f"{ASK} --duration 1e-3 --stiffness 1", "--stiffness or duration: both given"),
    (ASK, "--stiffness or duration: neither given"),
    ("contact --engine mujoco --restitution 1", "--masses: not given; legal: a value, or "),
    (f"{ASK} --stiffness 1 --masses inf inf", "two fixed bodies do not collide"),
    (f"{ASK} --stiffness 1 --masses 1e-12 1e12", "one is 1e+24 times the other; legal: at most 1e+12"),
    (f"{ASK} --stiffness 1 --speed nan", "--speed = nan; legal: from 1e-09 to 1e+09 (m/s)"),
    (f"{ASK} --stiffness 1 --engine dart", "--engine = 'dart'; legal: mujoco, pybullet, drake"),
    (STEEL, "--radius: given 0 times; legal: once or twice, beside material"),
    (f"{STEEL} --radius inf", "--radius = inf inf: two flats"),
    (f"{STEEL} --radius 1 --material stone", "--material = 'stone'; legal: steel, glass, brass, rubber, "),
    (f"{STEEL} --radius 0.02 --material brass", "--restitution of brass: none has a source"),
    (f"{STEEL} --radius 0.02 --stiffness 1", "--stiffness: given beside materials"),
    (f"{STEEL} --radius 0.02 --speed 0", "--speed = 0.0; legal"),
]


@pytest.mark.parametrize(("typed", "says"), WRONG)
def test_what_is_typed_wrongly_is_one_line_and_exit_code_2(typed, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    assert main(typed.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("impact-xval: ")
    assert says in err.replace("argument (b)", "argument(s) (b)")  # older versions of typer
    assert [each.name for each in tmp_path.iterdir()] == ["folder.png"]


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
