"""The one exception whose message is meant for the user."""

from __future__ import annotations

from impact_xval.experiments.config.visible import visible


class UserError(Exception):
    """What the user asked for cannot be done; the message is one line that says what and where.

    The command line prints it without a traceback and ends with exit code 2.
    """

    def __init__(self, message: str) -> None:
        super().__init__(visible(" ".join(str(message).split())))


class InterruptedRunError(Exception):
    """The run was stopped before its end; what is done is kept. The message is one line."""

    def __init__(self, message: str) -> None:
        super().__init__(visible(" ".join(str(message).split())))
