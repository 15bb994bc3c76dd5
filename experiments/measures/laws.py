"""Solvers by the law they were asked for: those asked for one law are one vote on it, however many they are."""

from __future__ import annotations

from collections.abc import Iterable

from impact_xval.compliant_baselines.contract.registry import law_of
from impact_xval.experiments.tables.numbers import listed

#: What every comparison of this project is, and is not; near the top of each page.
LAWS_WITH_LAWS = (
    "Everything here compares laws of contact with one another; no laboratory measurement is in it. No number says "
    "which law is nearer to a real collision."
)

_WORDS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def by_law(names: Iterable[str]) -> dict[str, list[str]]:
    """Group solvers by the law they have or were asked for.

    Returns
    -------
    dict
        Solvers by law, laws in the order of their first solver; of each the exact solver first, if it is among them.
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(law_of(name), []).append(name)
    return {law: sorted(group, key=lambda name: name != law) for law, group in groups.items()}


def in_order_of_laws(names: Iterable[str]) -> list[str]:
    """List solvers so that those of one law stand together."""
    return [name for group in by_law(names).values() for name in group]


def voters(names: Iterable[str]) -> list[str]:
    """List one solver a law: the exact one, or the first that was asked for it."""
    return [group[0] for group in by_law(names).values()]


def one_vote(names: Iterable[str]) -> str:
    """Say which solvers were asked for one law, a sentence for each such law; empty where all laws differ."""
    return " ".join(
        f"{listed(group)} were asked for the same law: one vote, not "
        f"{_WORDS[len(group)] if len(group) < len(_WORDS) else len(group)}."
        for group in by_law(names).values()
        if len(group) > 1
    )


def with_votes(caption: str, names: Iterable[str]) -> str:
    """Add `one_vote` to a caption that lists solvers; with or without a full stop at its end."""
    said = one_vote(names)
    return f"{caption.removesuffix('.')}. {said}" if said else caption
