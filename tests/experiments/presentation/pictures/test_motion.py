"""A collision in slow motion: every picture is there, and words say what the clock is."""

import base64
import re
from io import BytesIO

import numpy as np
from PIL import Image

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.pictures.motion import FRAMES, RATE

ASKED = "solve --stiffness-ratio 1 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --solver kelvin-voigt"


def test_a_gif_shows_every_picture(tmp_path):
    assert main([*ASKED.split(), "--plot", str(tmp_path / "one.gif")]) == 0
    assert [each.name for each in tmp_path.iterdir()] == ["one.gif"]
    with Image.open(tmp_path / "one.gif") as picture:
        assert picture.n_frames == FRAMES
        assert picture.info["duration"] * RATE == 1000
        first = np.asarray(picture.convert("RGB"), int)
        picture.seek(FRAMES // 2)
        assert np.abs(np.asarray(picture.convert("RGB"), int) - first).max() > 100  # something moves


def test_a_page_needs_nothing_else_and_says_what_the_clock_is(tmp_path):
    assert main([*ASKED.split(), "--plot", str(tmp_path / "one.html")]) == 0
    page = (tmp_path / "one.html").read_text(encoding="utf-8")
    pictures = re.findall(r"data:image/png;base64,([^\"]+)\"", page)
    assert len(pictures) == FRAMES
    with Image.open(BytesIO(base64.b64decode(pictures[10]))) as picture:
        assert min(picture.size) > 400
    rest = " ".join(re.sub(r"data:image/png;base64,[^\"]+", "", page).split())
    assert not re.search(r"https?:|<link|@import|url\(", rest)
    assert "the model and exact Kelvin-Voigt: k2/k1 = " in rest
    assert "The model has no time: its clock is how long its forces" in rest
