"""The contact pairs that cases of a sweep share."""

from collections.abc import Mapping

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.parallel import together

#: by group: its contact pair, or why there is none
Pairs = Mapping[int, ContactPair | ComputationError]


def pair_of(case: Case, comm: MPI.Comm) -> ContactPair | ComputationError:
    """Return the contact pair of a case, or why there is none. Collective on comm."""
    try:
        with together(comm):
            return assemble(case, comm)
    except InputError:
        raise
    except Exception as error:
        return ComputationError(str(error) or repr(error))
