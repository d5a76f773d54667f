"""Contact pairs of all tests at values of the fitted keys: exact, or interpolated for a search."""

from collections.abc import Hashable

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.derivatives.keys import is_elastic
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.interpolated_pairs import InterpolatedPairs, interpolate
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.identification.definition.problem import Problem

#: most pairs kept of points that have some of their own
_MOST_PAIRS = 64
#: bodies assembled for a search by start: each of its some ten points would need three or more
_BODIES_A_START = 16


class Operators:
    """Contact pairs of the experiments of a problem.

    Making them is collective on comm.

    Parameters
    ----------
    problem : the problem.
    comm : of the ranks that share the assembly.

    Attributes
    ----------
    owners : of each experiment, what its pair at the starts has in common with those of others.

    Raises
    ------
    ComputationError : the assembly.
    """

    def __init__(self, problem: Problem, comm: MPI.Comm) -> None:
        self._problem = problem
        self.owners: list[Hashable] = [operator_key(e.case) for e in problem.experiments]
        #: experiments of which each value of a fitted key has an operator of its own
        self._elastic = {
            i for i, e in enumerate(problem.experiments) if is_elastic(e.case, problem.keys)
        }
        self._pairs: dict[Hashable, ContactPair] = {}
        #: those of the last points
        self._at_points: dict[tuple[Hashable, bool], ContactPair] = {}
        #: where those of other points may come from in a search
        self._interpolated: dict[Hashable, InterpolatedPairs] = {}
        for key, experiment in zip(self.owners, problem.experiments, strict=True):
            if key not in self._pairs:
                self._pairs[key] = assemble(experiment.case, comm)

    @property
    def order(self) -> list[int]:
        """The number of each experiment's pair, as they were assembled."""
        pairs = list(self._pairs)
        return [pairs.index(owner) for owner in self.owners]

    def interpolate(self, comm: MPI.Comm) -> None:
        """Prepare operators for a search, between exact ones, where these pay. Collective."""
        bounds = {parameter.key: parameter.bounds for parameter in self._problem.parameters}
        most = _BODIES_A_START * self._problem.settings.starts
        for experiment in sorted(self._elastic):
            owner = self.owners[experiment]
            if owner in self._interpolated:
                continue
            case = self._problem.experiments[experiment].case
            pairs = interpolate(case, self._pairs[owner], bounds, most, comm)
            if pairs is not None:
                self._interpolated[owner] = pairs

    @property
    def are_interpolated(self) -> bool:
        """Whether there are operators for a search."""
        return bool(self._interpolated)

    def of(self, experiment: int, case: Case, exact: bool) -> ContactPair:
        """Return the pair of a case of an experiment.

        Where each value has its own, it is interpolated, or assembled by this rank alone.
        """
        owner = self.owners[experiment]
        if experiment not in self._elastic:
            return self._pairs[owner]
        exact = exact or owner not in self._interpolated
        key = operator_key(case)
        if exact and key in self._pairs:
            return self._pairs[key]
        if (key, exact) not in self._at_points:
            while len(self._at_points) >= _MOST_PAIRS:
                del self._at_points[next(iter(self._at_points))]
            self._at_points[key, exact] = (
                assemble(case, MPI.COMM_SELF, use_kept=False)
                if exact
                else self._interpolated[owner].of(case)
            )
        return self._at_points[key, exact]
