"""Readings of the tests' histories, computed together and kept as long as they may be asked for."""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.problem import Experiment, Problem
from ringwear_par.identification.model.histories import ROUGH_STEPS, STEPS, Histories, HistoryError


class Responses:
    """Readings of a problem's tests and their derivatives, one history a test.

    Points are unknowns of the fitted keys, or of these and the nuisances.

    Parameters
    ----------
    problem : whose tests they are.
    histories : of its experiments.

    Attributes
    ----------
    steps : about how many a history makes.
    exact : whether the operators of histories are; those of a search may be interpolated.
    known : readings of each test with derivatives (n, 1 + m), or why there are none, by its number
        and the bytes of the keys' values.
    """

    def __init__(self, problem: Problem, histories: Histories) -> None:
        self._problem, self._histories = problem, histories
        self.steps, self.exact = STEPS, True
        self.known: dict[tuple[int, bytes], FloatArray | HistoryError] = {}

    def _values(self, point: FloatArray) -> FloatArray:
        return self._problem.values(point[: len(self._problem.parameters)])

    def allowed(self, points: FloatArray) -> BoolArray:
        """Return at which points (p, m) all rules of the laws hold, (p,)."""
        return self._histories.allowed(np.array([self._values(point) for point in points]))

    def compute(self, points: Sequence[FloatArray]) -> None:
        """Have the histories at points computed together, and keep them. Not collective."""
        tests = range(len(self._problem.experiments))
        self.prepare([(test, v) for v in map(self._values, points) for test in tests])

    def prepare(self, wanted: Sequence[tuple[int, FloatArray]]) -> None:
        """Have the histories of tests at values of the keys computed together, and keep them."""
        new = {(test, v.tobytes()): v for test, v in wanted}
        new = {key: v for key, v in new.items() if key not in self.known}
        values = list({v.tobytes(): v for v in new.values()}.values())
        numbers = {v.tobytes(): i for i, v in enumerate(values)}
        pairs = [(numbers[content], test) for test, content in new]
        if pairs:
            responses = self._histories.read(np.array(values), pairs, self.steps, exact=self.exact)
            self.known.update(zip(new, responses, strict=True))

    def are_known(self, point: FloatArray) -> bool:
        """Tell whether the histories at a point were computed."""
        return (0, self._values(point).tobytes()) in self.known

    def of_tests(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the readings of all tests and their derivatives by the values, (n, 1 + m).

        Parameters
        ----------
        values : (m,) of the keys in each test.

        Raises
        ------
        HistoryError : there is no history.
        """
        wanted = list(enumerate(values))
        self.prepare(wanted)
        responses = []
        for test, of_test in wanted:
            response = self.known[test, of_test.tobytes()]
            if isinstance(response, HistoryError):
                raise response
            responses.append(response)
        return np.concatenate(responses)

    def in_shorter_steps(self, values: FloatArray) -> FloatArray | HistoryError:
        """Return the readings (n,) of all tests in steps half as long, or why there are none."""
        (finer,) = self._histories.responses(values[None], 2 * self.steps, derivatives=False)
        return finer if isinstance(finer, HistoryError) else finer[:, 0]

    def forget(self, points: Sequence[FloatArray], but: FloatArray) -> None:
        """Forget the histories at points, but for those at one."""
        past = {self._values(point).tobytes() for point in points} - {self._values(but).tobytes()}
        for key in [key for key in self.known if key[1] in past]:
            del self.known[key]

    def keep_only(self, values: Sequence[FloatArray]) -> None:
        """Forget all histories but those at values of each test. Not collective."""
        self.of_tests(values)
        remaining = {(test, of_test.tobytes()) for test, of_test in enumerate(values)}
        self.known = {key: response for key, response in self.known.items() if key in remaining}

    def renew_inputs(self, values: FloatArray) -> tuple[Experiment, ...]:
        """Return the tests with friction as torques tell it at values of the keys (m,).

        Histories are those of these tests from now on. Not collective.
        """
        self.known = {}
        return self._histories.renew_inputs(values)

    def part_from_histories(self) -> None:
        """Let the histories' engines and communicator go: responses computed so far remain."""
        del self._histories

    def refine(self) -> None:
        """Have histories make twice as many steps from now on."""
        self.steps *= 2
        self.known = {}

    def be_exact(self, exact: bool) -> None:
        """Have histories on exact operators from now on, or rough ones: interpolated, few steps."""
        if exact != self.exact:
            self.steps = STEPS if exact else ROUGH_STEPS
            self.exact, self.known = exact, {}
