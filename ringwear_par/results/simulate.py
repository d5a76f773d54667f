"""From a case to its result: ``rw.simulate``, the path that ``run`` and ``sweep`` take as well."""

from mpi4py import MPI

from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError
from ringwear_par.history.elastic import operator_key
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.refusals import check_case
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result


def simulate(
    case: Case,
    comm: MPI.Comm | None = None,
    *,
    pair: ContactPair | None = None,
) -> Result:
    """Return the wear history of a case.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    case : the case, see ``read_case``.
    pair : what ``assemble`` made of a case of the same shape, mesh, Poisson's ratios and grip, to
        be used again; None: it is assembled. With ``geometry = "updated"`` numbers may differ in
        the last digits between both.

    Returns
    -------
    Result : ``.histories`` over time, ``.profiles`` over time and radius, ``.doubts``.

    Raises
    ------
    InputError : no case, a law that is none, a mesh or a memory that cannot be, bodies that
        interpenetrate, a pair of another shape.
    ComputationError : a step failed; it is named with its time.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> result = rw.simulate(rw.read_case("scripts/cases/paper.toml"))
    >>> print(f"{1e3 * result.histories['penetration'][-1]:.2f} um")
    9.73 um
    """
    need_case(case, "simulate")
    comm = MPI.COMM_WORLD if comm is None else comm
    on_first_rank(comm, lambda: check_case(case, comm.size, "case"))
    if pair is not None and pair.key != operator_key(case):
        raise InputError(
            "pair: was assembled for another shape, mesh, Poisson's ratio or grip; must be "
            "assemble(case) of a case that shares them"
        )
    recorder = Recorder([case], comm, pair_is_shared=pair is not None)
    simulate_one(case, comm, recorder, pair=pair)
    return recorder.result()
