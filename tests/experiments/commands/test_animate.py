"""``impact-xval animate``: what is written, what is in it, and one line for what cannot be shown."""

import base64
import re
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from impact_xval.compliant_baselines.contract import registry
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.pictures import motion
from impact_xval.experiments.presentation.pictures.motion import FRAMES, Motion, Scene
from impact_xval.model import Collision
from tests.experiments import fakes

BESIDE = ["--solver", "kelvin-voigt"]


def _words(text):
    return " ".join(text.split())


def test_a_gif_shows_every_picture_and_its_caption_says_what_the_clock_is(tmp_path, capsys):
    path = tmp_path / "one.gif"
    assert main(["animate", *BESIDE, "--out", str(path)]) == 0
    assert [each.name for each in tmp_path.iterdir()] == ["one.gif"]
    with Image.open(path) as picture:
        assert picture.n_frames == FRAMES
        assert picture.info["duration"] * motion.RATE == 1000
        first = np.asarray(picture.convert("RGB"), int)
        picture.seek(FRAMES // 2)
        assert np.abs(np.asarray(picture.convert("RGB"), int) - first).max() > 100  # something moves
    said = _words(capsys.readouterr().out)
    assert "state-transition and kelvin-voigt" in said
    assert "The model is stated in impulses and has no time and no positions" in said


def test_a_page_needs_nothing_else(tmp_path):
    path = tmp_path / "one.html"
    assert main(["animate", *BESIDE, "--out", str(path)]) == 0
    page = path.read_text(encoding="utf-8")
    pictures = re.findall(r"data:image/png;base64,([^\"]+)\"", page)
    assert len(pictures) == FRAMES
    with Image.open(BytesIO(base64.b64decode(pictures[10]))) as picture:
        assert min(picture.size) > 400
        assert picture.convert("RGB").getpixel((0, 0)) == (255, 255, 255)
    rest = re.sub(r"data:image/png;base64,[^\"]+", "", page)
    assert not re.search(r"https?:|<link|fa fa-|@import|url\(", rest)
    assert "has no time and no positions" in _words(rest)
    assert '<img alt="One collision in slow motion: state-transition and kelvin-voigt"' in rest
    assert re.search(r'<input aria-label="[^"]+" id="[^"]+" type="range"', rest)
    assert path.stat().st_size < 5e6


@pytest.mark.skipif(not motion.has_ffmpeg(), reason="needs ffmpeg")
@pytest.mark.slow
def test_a_film(tmp_path):
    path = tmp_path / "one.mp4"
    assert main(["animate", *BESIDE, "--out", str(path)]) == 0
    assert path.read_bytes()[4:8] == b"ftyp"
    assert [each.name for each in tmp_path.iterdir()] == ["one.mp4"]


def test_without_mujoco_it_is_kelvin_voigt(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(registry, "get_solver", fakes.without_mujoco)
    assert main(["animate", "--out", str(tmp_path / "one.gif")]) == 0
    assert "state-transition and kelvin-voigt" in _words(capsys.readouterr().out)


def test_what_cannot_be_shown_is_one_line_and_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(motion, "has_ffmpeg", lambda: False)
    for arguments, says in (
        (["--out", "one.avi"], "--out one.avi: legal: a file that ends in .gif, .html, .mp4"),
        (["--out", "one.mp4"], "ffmpeg is not found; legal: a file that ends in .gif or .html"),
        (["--out", "there/one.gif"], "--out there/one.gif: there is no folder; legal: "),
        (["--e1", "2"], "--e1 = 2.0; legal: "),
        (["--solver", "nobody"], "--solver "),
        (["--solver", "state-transition"], "legal: another solver than the model"),
        ([*BESIDE, "--e1", "0"], "kelvin-voigt: unrepresentable: "),
        (["--solver", "bistiffness", "--stiffness-ratio", "0"], "state-transition ends after no finite time"),
    ):
        assert main(["animate", *arguments]) == 2, arguments
        said = capsys.readouterr().err
        assert says in said
        assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_contact_that_does_not_act_is_grey():
    with motion.drawing(3, 3) as figure:
        ax = figure.subplots()
        scene = Scene(ax, Motion(Collision.from_ratios(1.0, 1.0, 0.9, 0.7), "impact", {}), 1.0, 1.0)
        shown = {}
        for state in (1, 2, 3, 4):
            scene.show(np.zeros(2), np.zeros(2), np.zeros(2), state)
            idle = [spring.get_color() == motion._IDLE for spring in scene.springs]
            shown[scene.state.get_text()[:2]] = idle
    assert shown == {"S1": [False, False], "S2": [True, False], "S3": [False, True], "S4": [True, True]}
