"""Solvers by the law they were asked for: those asked for one law are one vote on it, however many they are."""

from __future__ import annotations

from collections.abc import Iterable

from impact_xval.compliant_baselines.registry import is_mapped, law_of
from impact_xval.compliant_baselines.solver import MappingName


def by_law(names: Iterable[str]) -> dict[str, list[str]]:
    """Group solvers by the law they have or were asked for, the exact solver first; one without a law is alone."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(law_of(name) or name, []).append(name)
    return {law: sorted(group, key=lambda name: name != law) for law, group in groups.items()}


def in_order_of_laws(names: Iterable[str]) -> list[str]:
    """List solvers so that those of one law stand together."""
    return [name for group in by_law(names).values() for name in group]


def voters(names: Iterable[str]) -> list[str]:
    """List one solver a law: the exact one, or the first that was asked for it."""
    return [group[0] for group in by_law(names).values()]


def exact_for(name: str, mapping: MappingName) -> str:
    """Name the exact solver of the law a solver was asked for; empty without one, as with a mapping of its own."""
    return "" if mapping == "naive" or is_mapped(name) else law_of(name) or ""
