"""The contact pairs that cases of a sweep share."""

from collections.abc import Mapping

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity import pair_cache
from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.stress.recovery import load_stress_kernels
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.lockstep import must_run_alone
from ringwear_par.parallel import on_first_rank, together
from ringwear_par.studies.execution.plan import Plan

#: by group: its contact pair, or why there is none
Pairs = Mapping[int, ContactPair | ComputationError]


def load_kernels_of(plan: Plan, comm: MPI.Intracomm) -> None:
    """Load what assembles and recovers stresses, where cases need it. Collective.

    By all ranks together, not by each team when it needs them.
    """

    def known() -> bool:
        cases = map(plan.first_case, plan.left)
        return all(not must_run_alone(c) and pair_cache.has(operator_key(c)) for c in cases)

    if not on_first_rank(comm, known):
        load_kernels(comm)
    if plan.cases_left and plan.first_case(plan.left[0]).stress is not None:
        load_stress_kernels(comm)


def pair_of(case: Case, comm: MPI.Comm) -> ContactPair | ComputationError:
    """Return the contact pair of a case, or why there is none. Collective on comm."""
    try:
        with together(comm):
            return assemble(case, comm)
    except InputError:
        raise
    except Exception as error:
        return ComputationError(str(error) or repr(error))
