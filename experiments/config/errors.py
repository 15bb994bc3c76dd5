"""The exceptions whose messages are meant for the user."""

from __future__ import annotations


class _OneLineError(Exception):
    def __init__(self, message: str) -> None:
        from impact_xval.compliant_baselines.answers import visible  # its room imports numpy

        super().__init__(visible(" ".join(str(message).split())))


class UserError(_OneLineError):
    """What the user asked for cannot be done; the message is one line that says what and where.

    The command line prints it without a traceback and ends with exit code 2.
    """


class InterruptedRunError(_OneLineError):
    """The run was stopped before its end; what is done is kept. The message is one line."""
