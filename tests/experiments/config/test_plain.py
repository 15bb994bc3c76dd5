"""Infinities through JSON and back."""

import json
import math

from impact_xval.experiments.config.configuration import from_canonical, parse_config
from impact_xval.experiments.config.plain import plain_values, revive

VALUES = {
    "name": "inf",
    "cells": "inf",
    "solvers": ["inf", "mujoco"],
    "stiffness_ratio_cutoff": math.inf,
    "grid": {"stiffness_ratio": [0.0, 1.5, math.inf], "mass_ratio": {"log": [0.5, 2, 3]}},
    "search": {"solver": "inf", "n": 3},
    "workers": None,
    "enabled": True,
}


def test_values_come_back_from_json_as_they_were():
    stored = json.dumps(plain_values(VALUES), allow_nan=False)
    assert revive(json.loads(stored)) == VALUES


def test_an_infinity_is_a_text_and_nothing_else_changes():
    plain = plain_values(VALUES)
    assert plain["stiffness_ratio_cutoff"] == "inf"
    assert plain["grid"]["stiffness_ratio"] == [0.0, 1.5, "inf"]
    assert {key for key in VALUES if plain[key] != VALUES[key]} == {"stiffness_ratio_cutoff", "grid"}


def test_a_configuration_comes_back_from_its_canonical_form():
    grid = {"stiffness_ratio": [0, math.inf], "mass_ratio": [1.0]}
    config = parse_config({"name": "inf", "stiffness_ratio_cutoff": math.inf, "grid": grid})
    canonical = json.loads(json.dumps(config.canonical(), allow_nan=False))
    assert from_canonical(canonical, "here") == config
