"""The command `impact-xval solve --plot`: the file's suffix decides what is written, and films show every solver."""

import base64
import json
import re
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.presentation.pictures.motion import FRAMES, RATE, SlowMotion, draw_frames
from impact_xval.model import Outcome, solve

BESIDE = "solve --stiffness-ratio 1 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --solver kelvin-voigt"
CHAIN_OPTIONS = "solve --arrangement cradle --balls 3 --solver kelvin-voigt"


@pytest.mark.parametrize(
    ("asked", "suffix", "first", "says"),
    [
        (BESIDE, "png", b"\x89PNG", "One collision by "),
        (BESIDE, "pdf", b"%PDF", "Markers show where each curve ends."),
        (CHAIN_OPTIONS, "svg", b"<?xml", "final velocities"),
    ],
)
def test_the_suffix_says_what_is_written_and_json_stays_json(tmp_path, capsys, asked, suffix, first, says):
    drawn(tmp_path / f"one.{suffix}", capsys, asked, first, says)


def drawn(file, capsys, asked, first, says):
    assert main([*asked.split(), "--json", "--plot", str(file)]) == 0
    out, err = capsys.readouterr()
    assert len(json.loads(out)) == 2
    assert says in " ".join(err.split())
    assert file.read_bytes().startswith(first)


def test_a_film_moves_as_long_as_it_says(tmp_path, capsys):
    says = "slow motion: the model and exact Kelvin-Voigt: a cradle of 3 balls"
    drawn(tmp_path / "one.gif", capsys, CHAIN_OPTIONS, b"GIF8", says)
    with Image.open(tmp_path / "one.gif") as picture:
        assert picture.n_frames == FRAMES
        assert picture.info["duration"] * RATE == 1000
        first = np.asarray(picture.convert("RGB"), int)
        picture.seek(FRAMES // 2)
        # a picture in the middle differs from the first one
        assert np.abs(np.asarray(picture.convert("RGB"), int) - first).max() > 100


def test_a_page_needs_nothing_else_and_says_what_the_clock_is(tmp_path, command):
    command([*BESIDE.split(), "--plot", tmp_path / "one.html"])
    assert [each.name for each in tmp_path.iterdir()] == ["one.html"]
    page = (tmp_path / "one.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    pictures = re.findall(r"data:image/png;base64,([^\"]+)\"", page)
    assert len(pictures) == FRAMES
    with Image.open(BytesIO(base64.b64decode(pictures[10]))) as picture:
        assert min(picture.size) > 400
    rest = " ".join(re.sub(r"data:image/png;base64,[^\"]+", "", page).split())
    assert not re.search(r"https?:|<link|@import|url\(", rest)
    assert "the model and exact Kelvin-Voigt: k2/k1 = " in rest
    assert "The model has no time of its own. The time shown is" in rest


CHAIN = ChainSetup(arrangement="row", balls=2)


def _of(chain, names, **others):
    """Make a film of a chain in which all named solvers move as the model does."""
    problem = chain.collision()
    outcome = solve(problem, path=True)
    return SlowMotion.of(
        problem, {name: outcome for name in names} | others, parse_config({"chain": {}}), chain
    )


SIX = ["mujoco", "pybullet", "kelvin-voigt", "bistiffness", "hunt-crossley", "rapier"]


def test_all_solvers_that_were_asked_for_move_side_by_side_and_those_left_out_are_named():
    problem = CHAIN.collision()
    lost = Outcome.failure("drake", problem, "unavailable", "not here")
    motion = _of(CHAIN, [*SIX, "dart", "state-transition"], drake=lost)
    assert list(motion.histories) == ["state-transition", *SIX]
    assert motion.left_out == {"dart": "at most 6 solvers are shown", "drake": "unavailable"}
    assert "Not shown: DART (at most 6 solvers are shown) and Drake (unavailable)." in motion.caption()
    assert "Rapier" in motion.title()
    assert "Not shown" not in _of(CHAIN, ["state-transition", *SIX]).caption()


def test_a_solver_moves_where_the_model_has_no_positions():
    problem = CHAIN.collision()
    refused = Outcome.failure("state-transition", problem, "unrepresentable", "gaps")
    motion = _of(CHAIN, ["mujoco"], **{"state-transition": refused})
    assert list(motion.histories) == ["mujoco"]
    assert "The model has no time" not in motion.caption()


@pytest.mark.parametrize("arrangement", ["cradle", "stack"])
def test_a_cradle_lies_and_a_stack_stands(arrangement):
    """The balls of a cradle are drawn beside one another, the balls of a stack above one another.

    The picture is searched for the grey of balls 1 and 3 of the first solver.
    """
    motion = _of(ChainSetup(arrangement=arrangement, balls=3), ["state-transition", "bistiffness"])
    picture = next(draw_frames(motion))
    high, wide, _ = picture.shape
    stands = arrangement == "stack"
    # the scene of the first solver; the forces of its contacts, which have a grey grid, are below or to the right of it
    scene = picture[: int(0.7 * high), : wide // 2] if stands else picture[: high // 2, : int(0.6 * wide)]
    down, across = np.nonzero(np.abs(scene.astype(int) - 0xB0).max(axis=-1) <= 1)
    # percentiles, because single pixels at the rims of letters have this grey, too
    of_balls = [np.ptp(np.percentile(each, [5, 95])) for each in (down, across)]
    assert of_balls[0] > 2 * of_balls[1] if stands else of_balls[1] > 2 * of_balls[0]


def test_what_does_not_move_is_one_line_and_nothing_is_written(tmp_path, capsys):
    assert main([*BESIDE.split(), "--e1", "0", "--plot", str(tmp_path / "one.gif")]) == 2
    said = capsys.readouterr().err
    assert "needs a second solver, beside the model, whose path" in said
    assert (said.count("\n"), [*tmp_path.iterdir()]) == (1, [])
