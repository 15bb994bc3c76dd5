"""A mistyped command line gets a message of one line that names the command and the option.

The tests also check that `impact-xval COMMAND --help` and `impact-xval COMMAND -h` print the help of a command.
"""

import pytest
import typer

from impact_xval.experiments.commands.cli import app

COMMANDS: list[str] = sorted(vars(typer.main.get_command(app))["commands"])

CELL = "solve --stiffness-ratio 1 --mass-ratio 1 --e1 0.9 --e2 0.7"
CRADLE = "solve --arrangement cradle"
GRAPH = "solve --graph"
PLOT = "legal: a file that ends in .png, .svg, .pdf, .gif, .html"
ASK = "contact --engine mujoco --masses 1.0 0.5 --restitution 0.7"
OF_TWO = "contact --engine mujoco --masses 1 1"
STEEL = "contact --engine mujoco --material steel"
#: The typed words, and parts of the message. If an option is given twice, the last one counts.
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
    (f"{CELL} --plot one.avi", f"--plot = 'one.avi'; {PLOT}"),
    (f"{CELL} --plot folder.png", f"--plot = 'folder.png'; {PLOT}"),
    (f"{CELL} --plot there/one.gif", "--plot = 'there/one.gif': no folder there"),
    *((f"inspect any.xml --speed={x}", "--speed = ") for x in ("0", "-1", "inf", "nan", "fast")),
    ("inspect gone.xml", "gone.xml: no such file of MuJoCo; legal: a file that ends in .xml or .mjb"),
    (f"{ASK} --stiffness 1 --restitution 0", "--restitution = 0.0; legal: from 0.0001 to 1"),
    (f"{ASK} --stiffness 1 --restitution half", "--restitution = 'half'; legal: one or two numbers"),
    (f"{ASK} --stiffness 1 --masses 1", "--masses = '1'; legal: two or three numbers"),
    (f"{ASK} --stiffness 1 --masses 1 2 3 4", "--masses = '1 2 3 4'; legal: two or three numbers"),
    (f"{ASK} --stiffness 1 --masses 1 inf 2", "--masses = 1 inf 2: of three bodies only the last one may be"),
    (
        f"{ASK} --duration 1e-3 --stiffness 1",
        "--stiffness = 1.0 and duration = 0.001: each follows from the other",
    ),
    (
        f"{ASK} --duration 1e-3 --step 1e-3",
        "--step = 0.001 beside duration: each follows from the other; legal: one of",
    ),
    (
        f"{ASK} --damping 1 --sink 1",
        "--restitution = 0.7 and damping = 1.0: each follows from the other; legal: one of",
    ),
    (ASK, "--stiffness, duration, step or sink: none given; legal: one of them; the others follow from it"),
    ("contact --engine mujoco --masses 1 1 --sink 1", "--restitution, damping or damping-ratio: none given"),
    (
        f"{ASK} --stiffness 1 2",
        "--stiffness = 1 2: two numbers for one contact; legal: one, or three --masses",
    ),
    (f"{ASK} --restitution 1.5 --sink 1", "--restitution = 1.5; legal: from 0.0001 to 1"),
    (f"{ASK} --sink 0", "--sink = 0.0; legal: a finite number > 0 (m)"),
    (f"{ASK} --step 0", "--step = 0.0; legal: from 1e-12 to 1000 (s)"),
    (f"{ASK} --sink 1 --tolerance 0", "--tolerance = 0.0; legal: from 0.0001 to 0.3"),
    (f"{OF_TWO} --damping -1 --sink 1", "--damping = -1.0; legal: a finite number >= 0 (N s/m)"),
    (f"{OF_TWO} --damping-ratio -1 --sink 1", "--damping-ratio = -1.0; legal: from 0 to 50"),
    (
        f"{OF_TWO} --damping 1e9 --sink 1",
        "--damping = 1000000000.0 beside sink = 1.0: a damping ratio of",
        "legal: at most 50",
    ),
    (
        f"{OF_TWO} --damping 1e9 --duration 1",
        "--damping = 1000000000.0 beside duration = 1.0: a restitution of",
    ),
    (
        f"{OF_TWO} --solref -1 -1e3",
        "--solref = -1 -1000: the contact returns 1e-06 of the speed; legal: at least 0.0001",
    ),
    (f"{OF_TWO} --solref -1", "--solref = '-1'; legal: two numbers"),
    (
        f"{OF_TWO} --solref -1 1",
        "--solref = -1 1: the engine replaces two signs by its default 0.02 1; legal: ",
    ),
    (f"{OF_TWO} --solref 0 -1", "--solref = 0 -1: a contact without a spring; legal: "),
    (
        f"{OF_TWO} --solref 0.02 1 --sink 1",
        "--sink = 1: given beside solref, which decides it; legal: one of both",
    ),
    (f"{OF_TWO} 1 --solref 0.02 1", "--masses: 3 given; legal: two beside solref"),
    (
        f"{OF_TWO} --solref 0.02 1 --engine pybullet",
        "--solref: numbers of MuJoCo beside --engine pybullet; legal:",
    ),
    (f"{OF_TWO} --solimp 0.9 --sink 1", "--solimp: given alone; legal: beside solref"),
    (f"{OF_TWO} --solref 1 1 --solimp 0.9 half", "--solimp = '0.9 half'; legal: 1 to 5 numbers"),
    ("contact --engine mujoco --restitution 1", "--masses: not given; legal: two or three numbers, or "),
    (f"{ASK} --stiffness 1 --masses inf inf", "two fixed bodies do not collide"),
    (f"{ASK} --stiffness 1 --masses 1e-12 1e12", "one is 1e+24 times the other; legal: at most 1e+12"),
    (f"{ASK} --stiffness 1 --speed nan", "--speed = nan; legal: from 1e-09 to 1e+09 (m/s)"),
    (f"{ASK} --stiffness 1 --engine jolt", "--engine = 'jolt'; legal: mujoco, pybullet, drake"),
    (f"{ASK} --engine dart --solref 0.02 1", "--restitution = 0.7: given beside solref, which decides it"),
    (STEEL, "--radius: given 0 times; legal: once or twice, beside material"),
    (f"{STEEL} --radius inf", "--radius = inf inf: two flats"),
    (f"{STEEL} --radius 1 --material stone", "--material = 'stone'; legal: steel, glass, brass, rubber, "),
    (f"{STEEL} --radius 0.02 --material brass", "--restitution of brass: none has a source"),
    (f"{STEEL} --radius 0.02 --stiffness 1", "--stiffness = 1: given beside materials"),
    (f"{STEEL} --radius 0.02 --speed 0", "--speed = 0.0; legal"),
    (f"{ASK} --duration 1e-12", "--engine mujoco: unrepresentable: accelerations about "),
    (f"{CELL} --stiffness-ratio -1", "--stiffness-ratio = -1", "0 to inf"),
    (f"{CELL} --stiffness-ratio stiff", "--stiffness-ratio = 'stiff'", "0 to inf"),
    (f"{CELL} --mass-ratio 0", "--mass-ratio = 0", "a finite number > 0"),
    (f"{CELL} --v0 0", "--v0 = 0", "a finite number < 0"),
    (f"{CELL} --scenario=", "--scenario = ''", "'impact' or 'drop'"),
    (f"{CELL} --gravity -9 --scenario drop", "--gravity = -9", "a finite number > 0"),
    (f"{CELL} --gravity 5", "gravity = 5: scenario = 'impact' has none; legal: with 'drop'"),
    (f"{CELL} --k2 1e6", "--stiffness-ratio and --k2 are given; legal: one of both"),
    (f"{CELL} --gap 0", "--gap = '0'; legal: with --arrangement, of N balls"),
    (f"{CELL} --cell-timeout 0", "--cell-timeout = 0.0; legal: "),
    (f"{CELL} --solver bullet", "--solver 'bullet'", "did you mean 'pybullet'", "legal:"),
    (f"{CELL} --m1 1e-200 --v0 -1e-200", "v0 = -1e-200", "m1 = 1e-200", "a finite number > 0"),
    (f"{CRADLE} --balls 0 --arrangement stack", "--balls = 0", "from 1 to 1000, for a stack"),
    (f"{CRADLE} --balls 2.5", "--balls = 2.5", "a whole number from 2"),
    (f"{CRADLE} --e1 0.9", "--e1 = '0.9'; legal: none beside --arrangement"),
    (f"{CRADLE} --strike two", "--strike = 'two'", "a whole number from 1 to balls - 1"),
    (f"{CRADLE} --strike 1 --arrangement row", "--strike = 1", "none for a row"),
    (f"{CRADLE} --exponent 0.5", "--exponent = 0.5", "from 1 (linear contacts; 1.5: Hertz) to 3"),
    (f"{CRADLE} --gap -1e-5", "--gap = -1e-05", "a finite number >= 0 (m)"),
    (f"{CRADLE} --arrangement tower", "'tower'", "'row', 'cradle', 'pile' or 'stack'"),
    (f"{CRADLE} --mass-taper 0", "--mass-taper = 0.0", "a finite number > 0 (m_(i+1)/m_i)"),
    (f"{CRADLE} --k1 1e300 --stiffness-taper 1e10", "k = 1e+300, stiffness_taper = 1", "numbers > 0"),
    (f"{CRADLE} --m1 1e-200 --v0 -1e-200", "m = 1e-200", "v0 = -1e-200", "product > 0"),
    (f"{CRADLE} --e 2 --gap -1", "--e = 2.0", "(and 1 more)"),
    (
        f"{GRAPH} cornr",
        "--graph = 'cornr' is no graph (did you mean 'corner'?)",
        "legal: bernoulli, corner, ",
    ),
    (f"{GRAPH} rack --balls 5", "--balls = 5; legal: 3, 6 or 10"),
    (f"{GRAPH} rack --offset 90", "--offset = 90.0; legal: between -90 and 90 degrees"),
    (f"{GRAPH} bernoulli --angle 29", "--angle = 29.0; legal: from 30 to less than 90 degrees"),
    (f"{GRAPH} bernoulli --angle wide", "--angle = 'wide'; legal: a number"),
    (f"{GRAPH} bernoulli --restitution 1.5", "--restitution = '1.5'; legal: from 0 to 1"),
    (f"{GRAPH} bernoulli --stiffness-ratio 0", "--stiffness-ratio = 0.0; legal: a finite number > 0 (k2/k1)"),
    (f"{GRAPH} bernoulli --mass-ratio 2", "--mass-ratio = '2' beside --graph bernoulli; legal: --angle, "),
    (f"{GRAPH} corner --angle 180", "--angle = 180.0; legal: more than 0 and less than 180 degrees"),
    (
        f"{GRAPH} corner --velocity 1,1",
        "--velocity = '1,1': nothing meets; legal: the bodies of some contact ",
    ),
    (f"{GRAPH} corner --velocity 1", "--velocity = '1'; legal: two numbers X,Z (m/s)"),
    (f"{GRAPH} corner --velocity inf,0", "--velocity = 'inf,0'", "legal: finite numbers (m/s"),
    (f"{GRAPH} bridge --e1 2", "--e1 = '2'; legal: from 0 to 1"),
    (
        f"{GRAPH} bridge --table-stiffness-ratio -1",
        "--table-stiffness-ratio = -1.0; legal: a finite number > 0",
    ),
    (f"{GRAPH} box --inertia 0", "--inertia = 0.0; legal: a finite number > 0"),
    (f"{GRAPH} box --scenario drop", "--scenario = 'drop' beside --graph box; legal: --inertia, "),
    (f"{GRAPH} box --cell-timeout 0", "--cell-timeout = 0.0; legal: "),
    (f"{GRAPH} box --solver bullet", "--solver 'bullet'", "did you mean 'pybullet'", "legal:"),
    *(
        (f"{GRAPH} box --plot a.{x}", f"--plot = 'a.{x}' beside --graph; legal: .png, ")
        for x in ("gif", "html")
    ),
    (f"{CELL} --angle 30", "--angle = '30'; legal: with --graph"),
    (f"{CRADLE} --restitution 1", "--restitution = '1'; legal: with --graph"),
]


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: wrong[0])
def test_what_is_typed_wrongly_is_one_line_and_exit_code_2(wrong, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    refused(*wrong)
    assert [each.name for each in tmp_path.iterdir()] == ["folder.png"]


def test_both_words_for_help_are_legal_everywhere(command):
    for name in ([], *([name] for name in COMMANDS)):
        short, long = (command([*name, word]) for word in ("-h", "--help"))
        assert short == long
        assert short.startswith(" ".join(["Usage: impact-xval", *name]))
        assert short.count("\n") <= 40
        assert not name or "Example: impact-xval " + name[0] in short
