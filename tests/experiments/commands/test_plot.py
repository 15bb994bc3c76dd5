"""``impact-xval solve --plot``: the suffix says what is written; in slow motion every picture is there."""

import base64
import json
import re
from io import BytesIO

import numpy as np
from PIL import Image

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.pictures.motion import FRAMES, RATE

BESIDE = "solve --stiffness-ratio 1 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --solver kelvin-voigt"
COLUMN = "solve --arrangement cradle --balls 3 --solver kelvin-voigt"


def test_the_suffix_says_what_is_written_and_json_stays_json(tmp_path, capsys):
    for asked, suffix, first, says in (
        *((BESIDE, *each, "One collision by ") for each in (("png", b"\x89PNG"), ("svg", b"<?xml"))),
        (BESIDE, "pdf", b"%PDF", "markers: where each curve ends."),
        (COLUMN, "svg", b"<?xml", "final velocities"),
        (COLUMN, "gif", b"GIF8", "slow motion: the model and exact Kelvin-Voigt: a cradle of 3 balls"),
    ):
        file = tmp_path / f"one.{suffix}"
        assert main([*asked.split(), "--json", "--plot", str(file)]) == 0
        out, err = capsys.readouterr()
        assert len(json.loads(out)) == 2
        assert says in " ".join(err.split())
        assert file.read_bytes().startswith(first)
    with Image.open(tmp_path / "one.gif") as picture:
        assert picture.n_frames == FRAMES
        assert picture.info["duration"] * RATE == 1000
        first = np.asarray(picture.convert("RGB"), int)
        picture.seek(FRAMES // 2)
        assert np.abs(np.asarray(picture.convert("RGB"), int) - first).max() > 100  # something moves


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
    assert "The model has no time: its clock is how long its forces" in rest


def test_what_does_not_move_is_one_line_and_nothing_is_written(tmp_path, capsys):
    assert main([*BESIDE.split(), "--e1", "0", "--plot", str(tmp_path / "one.gif")]) == 2
    said = capsys.readouterr().err
    assert "needs the model and another solver with a path" in said
    assert (said.count("\n"), [*tmp_path.iterdir()]) == (1, [])
