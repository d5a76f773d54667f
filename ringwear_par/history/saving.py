"""What of a history is saved."""

from ringwear_par.cases.case import SAME_TIME, Case


def wants_boundary(case: Case, time: float, finished: bool, before: float) -> bool:
    """Tell whether the case asks for the boundary fields of a stored state.

    Parameters
    ----------
    time : s, of the state.
    finished : whether it is the last.
    before : s, time of the stored state before it; negative: there is none.
    """
    asked = case.output.boundary
    if isinstance(asked, str):
        return asked == "all" or (asked == "last" and finished)
    near = SAME_TIME * time
    return any(before + near < t <= time + near for t in asked)
