"""Every key of an experiment has a meaning and a default, which the documentation lists."""

from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.config.keys import MEANINGS, experiment_keys


def test_every_key_has_a_meaning_and_every_meaning_a_key():
    keys = [key.name for key in experiment_keys()]
    assert keys == [*MEANINGS]
    assert {"step_fraction", "grid.e", "sample.seed", "chain.balls"} <= {*keys}


def test_a_meaning_is_one_sentence_or_two():
    for name, meaning in MEANINGS.items():
        assert meaning.endswith("."), name
        assert "|" not in meaning, name


def test_keys_have_the_defaults_of_the_built_in_experiment():
    defaults = {key.name: key.default for key in experiment_keys()}
    assert defaults["convergence.halvings"] == Config().convergence.halvings
    assert defaults["grid.e1"] == Config().grid.e1
    assert defaults["cells"] is None
