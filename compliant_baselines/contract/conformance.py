"""Whether a solver keeps the contract: checks that an adapter's author can run, each named by what it demands.

From the command line, for a solver that is installed: ``impact-xval conform NAME``. In the author's own tests:

    import pytest
    from impact_xval.compliant_baselines.contract.conformance import checks
    from my_package.adapter import MyEngineSolver

    @pytest.mark.parametrize("check", checks("kelvin-voigt"), ids=lambda check: check.__name__)
    def test_contract(check):
        check(MyEngineSolver())

What they demand is said in `contract.conformance_checks`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from impact_xval.compliant_baselines.contract import conformance_checks as demands
from impact_xval.compliant_baselines.contract.conformance_checks import Check, NonConformingError
from impact_xval.compliant_baselines.contract.solver import Solver

#: Laws a solver may say it has, and the reference it is then held against.
Law = Literal["kelvin-voigt", "hunt-crossley", "none"]
LAWS: tuple[Law, ...] = ("kelvin-voigt", "hunt-crossley", "none")


def checks(law: Law = "kelvin-voigt") -> tuple[Check, ...]:
    """All checks, for a solver whose contacts obey a law.

    Parameters
    ----------
    law : str
        One of `LAWS`; ``"none"`` for a law of the solver's own, which is then not checked.

    Raises
    ------
    ValueError
        If the law is another one.
    """
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    common: tuple[Check, ...] = (
        demands.names_itself,
        demands.answers_every_collision,
        demands.same_bits_in_any_company,
        demands.refuses_with_a_reason,
        demands.raises_in_a_direct_call,
        demands.ends_apart_and_creates_no_energy,
        demands.scales,
        demands.has_a_drop,
        demands.gives_a_path,
        demands.leaves_no_trace,
    )
    return common if law == "none" else (*common, demands.converges_to(law))


def conform(solver: Solver, law: Law = "kelvin-voigt") -> Iterator[tuple[Check, str]]:
    """Run the checks one by one.

    Yields
    ------
    check : callable
        Its name and docstring say what it demands.
    problem : str
        What was found; ``""`` if the check passed. An exception of the solver is a finding.
    """
    for check in checks(law):
        try:
            check(solver)
        except NonConformingError as error:
            yield check, str(error)
        except Exception as error:
            yield check, " ".join(f"it raised {type(error).__name__}: {error}".split())
        else:
            yield check, ""
