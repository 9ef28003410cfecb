"""How a run ends."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """How a run ended; the value is the message.  Its place in the list is the code kept in arrays.

    What goes wrong in flight is one of these values, not an exception.

    See Also
    --------
    dpend.Run : Whose ``status`` it is.

    Examples
    --------
    >>> import dpend
    >>> dpend.Status.FULL_LENGTH.value
    'The run reached its full length.'
    """

    FULL_LENGTH = "The run reached its full length."
    TRACK_END = "The cart reached the end of the track."
    LINK1_FELL = "Link 1 fell: it leans by more than a quarter turn."
    LINK2_FELL = "Link 2 fell: it leans by more than a quarter turn."
    NOT_FINITE = "The state is no longer a finite number."
    CONTROLLER_FAILED = "The controller, or the push, failed; the run is kept up to there."

    @property
    def code(self) -> int:
        """The number that stands for this status in arrays; zero where nothing ended the run early."""
        return list(Status).index(self)
