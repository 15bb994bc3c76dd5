"""Another object in the place of an engine's module, for whatever imports that module meanwhile."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def standing_in(name: str, substitute: Any) -> Iterator[None]:
    """Let ``import name`` find a substitute, and the module that was imported before again afterwards."""
    before = sys.modules[name]
    sys.modules[name] = substitute
    try:
        yield
    finally:
        sys.modules[name] = before
