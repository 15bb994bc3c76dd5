"""Text of a solver, a file or a user, such as a reason or the name of a geom, as a terminal and a page can show it."""

from __future__ import annotations

import unicodedata

#: Categories of Unicode that are not shown: control, format (overrides of direction among them), and what is no letter.
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


def visible(text: str) -> str:
    r"""Write what a terminal would obey, or nobody would see, as Python does: ``\x1b``, ``\u202e``.

    Line feeds and tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(
        letter.encode("unicode_escape").decode()
        if unicodedata.category(letter) in _HIDDEN and letter not in "\n\t"
        else letter
        for letter in text
    )
