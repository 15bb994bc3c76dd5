"""A collision in slow motion: every picture is there, and words say what the clock is."""

import base64
import re
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.presentation.pictures import motion
from impact_xval.experiments.presentation.pictures.motion import FRAMES, Motion, write_animation
from impact_xval.model.collision import Collision

IMPACT = parse_config({"scenario": "impact"})


def motion_of(e1=0.9):
    collision = Collision.from_ratios(1.0, 1.1547, e1, 0.7)
    names, settings = ("state-transition", "kelvin-voigt"), Settings(record_path=True)
    outcomes = {name: get_solver(name).solve_many([collision], settings)[0] for name in names}
    return Motion.of(collision, outcomes, IMPACT, None)


@pytest.fixture(scope="module")
def moving():
    return motion_of()


def test_a_gif_shows_every_picture_and_its_caption_says_what_the_clock_is(tmp_path, moving):
    path = tmp_path / "one.gif"
    write_animation(moving, path)
    assert [each.name for each in tmp_path.iterdir()] == ["one.gif"]
    with Image.open(path) as picture:
        assert picture.n_frames == FRAMES
        assert picture.info["duration"] * motion.RATE == 1000
        first = np.asarray(picture.convert("RGB"), int)
        picture.seek(FRAMES // 2)
        assert np.abs(np.asarray(picture.convert("RGB"), int) - first).max() > 100  # something moves
    said = moving.caption()
    assert "the model and exact Kelvin-Voigt: k2/k1 = " in said
    assert "The model has no time: its clock is how long its forces" in said


def test_a_page_needs_nothing_else(tmp_path, moving):
    path = tmp_path / "one.html"
    write_animation(moving, path)
    page = path.read_text(encoding="utf-8")
    pictures = re.findall(r"data:image/png;base64,([^\"]+)\"", page)
    assert len(pictures) == FRAMES
    with Image.open(BytesIO(base64.b64decode(pictures[10]))) as picture:
        assert min(picture.size) > 400
    rest = re.sub(r"data:image/png;base64,[^\"]+", "", page)
    assert not re.search(r"https?:|<link|@import|url\(", rest)
    assert "The model has no time" in " ".join(rest.split())


def test_what_does_not_move_is_said():
    with pytest.raises(
        ValueError, match="needs the model and another solver with a path in finite time; legal"
    ):
        motion_of(e1=0.0)
