"""``impact-xval solve --plot``: the suffix says what is written, and one line what cannot be shown."""

import json

from impact_xval.experiments.commands.cli import main

BESIDE = "solve --stiffness-ratio 1 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --solver kelvin-voigt"


def test_the_suffix_says_what_is_written_and_json_stays_json(tmp_path, capsys):
    column = "solve --arrangement cradle --balls 3 --solver kelvin-voigt"
    for asked, suffix, first, says in (
        *((BESIDE, *each, "One collision by ") for each in (("png", b"\x89PNG"), ("svg", b"<?xml"))),
        (BESIDE, "pdf", b"%PDF", "markers: where each curve ends."),
        (BESIDE, "html", b"<!doctype html>", "The model has no time: its clock is how long its forces"),
        (column, "svg", b"<?xml", "final velocities"),
        (column, "gif", b"GIF8", "slow motion: the model and exact Kelvin-Voigt: a cradle of 3 balls"),
    ):
        file = tmp_path / f"one.{suffix}"
        assert main([*asked.split(), "--json", "--plot", str(file)]) == 0
        out, err = capsys.readouterr()
        assert len(json.loads(out)) == 2
        assert says in " ".join(err.split())
        assert file.read_bytes().startswith(first)


def test_what_does_not_move_is_one_line_and_nothing_is_written(tmp_path, capsys):
    assert main([*BESIDE.split(), "--e1", "0", "--plot", str(tmp_path / "one.gif")]) == 2
    said = capsys.readouterr().err
    assert "needs the model and another solver with a path" in said
    assert (said.count("\n"), [*tmp_path.iterdir()]) == (1, [])
