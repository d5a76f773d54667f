"""The two ways a command can fail, with their exit statuses."""


class RingwearError(Exception):
    """A failure that is told to the user in one sentence; exit status 1."""

    exit_status = 1


class ComputationError(RingwearError):
    """A computation that did not succeed: which case, step and residual."""


class LawError(ComputationError):
    """A user's wear law that failed; no other step will do."""


class InputError(RingwearError):
    """Bad input: one sentence a fault, all faults of a file together; exit status 2.

    Parameters
    ----------
    *faults : the sentences, each naming the file, the key, the value and what is allowed.
    """

    exit_status = 2

    def __init__(self, *faults: str) -> None:
        super().__init__("\n".join(faults))
        self.faults = faults

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, ...]]:
        return type(self), self.faults


class UnfitError(InputError):
    """A case whose own numbers do not go together, as only its first solution tells."""
