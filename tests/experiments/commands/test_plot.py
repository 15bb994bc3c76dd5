"""``impact-xval solve --plot``: what is written, what is in it, and one line for what cannot be shown."""

import base64
import json
import re
from io import BytesIO

import numpy as np
from PIL import Image

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.pictures import motion
from impact_xval.experiments.presentation.pictures.motion import FRAMES

CELL = ["solve", "--stiffness-ratio", "1", "--mass-ratio", "1.1547", "--e1", "0.9", "--e2", "0.7"]
BESIDE = [*CELL, "--solver", "kelvin-voigt"]


def test_a_gif_shows_every_picture_and_its_caption_says_what_the_clock_is(tmp_path, capsys):
    path = tmp_path / "one.gif"
    assert main([*BESIDE, "--plot", str(path)]) == 0
    assert [each.name for each in tmp_path.iterdir()] == ["one.gif"]
    with Image.open(path) as picture:
        assert picture.n_frames == FRAMES
        assert picture.info["duration"] * motion.RATE == 1000
        first = np.asarray(picture.convert("RGB"), int)
        picture.seek(FRAMES // 2)
        assert np.abs(np.asarray(picture.convert("RGB"), int) - first).max() > 100  # something moves
    said = " ".join(capsys.readouterr().err.split())
    assert "the model and exact Kelvin-Voigt: k2/k1 = " in said
    assert "The model has no time: its clock is how long its forces" in said


def test_a_page_needs_nothing_else(tmp_path):
    path = tmp_path / "one.html"
    assert main([*BESIDE, "--plot", str(path)]) == 0
    page = path.read_text(encoding="utf-8")
    pictures = re.findall(r"data:image/png;base64,([^\"]+)\"", page)
    assert len(pictures) == FRAMES
    with Image.open(BytesIO(base64.b64decode(pictures[10]))) as picture:
        assert min(picture.size) > 400
    rest = re.sub(r"data:image/png;base64,[^\"]+", "", page)
    assert not re.search(r"https?:|<link|@import|url\(", rest)
    assert "The model has no time" in " ".join(rest.split())


def test_the_suffix_says_what_is_written_and_json_stays_json(tmp_path, capsys):
    column = ["solve", "--arrangement", "cradle", "--balls", "3", "--solver", "kelvin-voigt"]
    for asked, suffix, first in (
        *((BESIDE, *each) for each in (("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF"))),
        *((column, *each) for each in (("svg", b"<?xml"), ("gif", b"GIF8"))),
    ):
        file = tmp_path / f"one.{suffix}"
        assert main([*asked, "--json", "--plot", str(file)]) == 0
        assert len(json.loads(capsys.readouterr().out)) == 2
        assert file.read_bytes().startswith(first)


def test_what_does_not_move_is_one_line_and_nothing_is_written(tmp_path, capsys):
    assert main([*BESIDE, "--e1", "0", "--plot", str(tmp_path / "one.gif")]) == 2
    said = capsys.readouterr().err
    assert "needs the model and another solver with a path" in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())
