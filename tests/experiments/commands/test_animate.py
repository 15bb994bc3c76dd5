"""``impact-xval animate``: what is written, what is in it, and one line for what cannot be shown."""

import base64
import re
from io import BytesIO

import numpy as np
from PIL import Image

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.pictures import motion
from impact_xval.experiments.presentation.pictures.motion import FRAMES

BESIDE = ["--solver", "kelvin-voigt"]


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
    said = " ".join(capsys.readouterr().out.split())
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
    rest = re.sub(r"data:image/png;base64,[^\"]+", "", page)
    assert not re.search(r"https?:|<link|@import|url\(", rest)
    assert "has no time and no positions" in " ".join(rest.split())


def test_what_cannot_be_shown_is_one_line_and_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(motion, "has_ffmpeg", lambda: False)
    for arguments, says in (
        (["--out", "one.avi"], "--out one.avi: legal: a file that ends in .gif, .html, .mp4"),
        (["--out", "one.mp4"], "ffmpeg is not found; legal: a file that ends in .gif or .html"),
        (["--out", "there/one.gif"], "--out there/one.gif: there is no folder; legal: "),
        (["--solver", "state-transition"], "legal: another solver than the model"),
        ([*BESIDE, "--e1", "0"], "kelvin-voigt: unrepresentable: "),
        (["--solver", "bistiffness", "--stiffness-ratio", "0"], "state-transition ends after no finite time"),
    ):
        assert main(["animate", *arguments]) == 2, arguments
        said = capsys.readouterr().err
        assert says in said
        assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())
