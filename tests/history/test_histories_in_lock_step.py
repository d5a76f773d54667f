"""Histories in lock step: as each would be alone, whoever the others are and whatever they do."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from mpi4py import MPI
from paths import CASES
from reference_cases import CONTACT, OMEGA, Rings, paper_case, ring_case

from ringwear_par.batched import one
from ringwear_par.cases.case import Load, Output, Stepping
from ringwear_par.cases.files.reading import read_case
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.errors import ComputationError, LawError
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.lockstep import batch_key
from ringwear_par.history.loop import simulate, simulate_one
from ringwear_par.schedules import Table
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.non_local import NonLocalLaw
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.table import TableLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.laws.user import UserLaw

ADAPTIVE = Stepping("adaptive", until=60.0)
STEPPINGS = {
    "adaptive": ADAPTIVE,
    "implicit": Stepping("implicit", 2.0, 8),
    "explicit": Stepping("explicit", 0.05, 8),
}
#: moduli that share the references of two families
OWN = ((10240.123, 1e5), (9973.001, 1.2e5), (1e4, 41234.56), (1e4 / 0.97, 99.9999e3))
USER = "def rate(p, at):\n    return at.parameters['k'] * at.friction * at.speed * p\n"
ALONE = MPI.COMM_SELF


@pytest.fixture(scope="module")
def flat():
    return paper_case(Mesh(16, grading=1.0), stepping=ADAPTIVE)


@pytest.fixture(scope="module")
def pair(flat):
    return assemble(flat, ALONE)


@dataclass(frozen=True)
class Own:
    """A user's object."""

    k: float = 1e-7

    def rate(self, p, at):
        """Return the rate."""
        return self.k * at.friction * at.speed * p


def laws_of(name, i):
    """Laws of lower and upper of one of some histories."""
    k = 10.0 ** (-8.0 + 0.4 * i)
    return {
        "threshold": (ThresholdLaw(k, 10.0 * (i % 4)), None),
        "two bodies": (ThresholdLaw(k, 20.0), ArchardLaw(0.1 * k)),
        "power": (PowerLaw(0.01 * k, 1.3 + 0.1 * i), None),
        "table": (TableLaw(((0.0, 0.0), (8e3, 2e-5), (2e4, 9e-5))), None),
        "memory": (RunningInLaw(k, 3.0 * k, 10.0, depth=1e-3 * (1 + i)), None),
        "distance": (RunningInLaw(k, 3.0 * k, distance=100.0 * (1 + i)), None),
        "non-local": (NonLocalLaw(k, 10.0, length=0.3), ThresholdLaw(k)),
        "user": (UserLaw("law.py", USER, (("k", k),)), None),
        "object": (Own(), ThresholdLaw(k)),
        "no wear": (None, None),
    }[name]


def of_laws(base, name, count=5):
    """Cases of one kind of law, load and friction of their own."""
    cases = []
    for i in range(count):
        lower, upper = laws_of(name, i)
        load = Load(OMEGA, base.load.force * (0.6 + 0.1 * i))
        cases.append(replace(base, friction=0.1 + 0.02 * i, load=load, wear_lower=lower,
                             wear_upper=upper))  # fmt: skip
    return cases


def loads(base):
    """Cases by what loads them."""
    force, laws = base.load.force, {"wear_lower": ThresholdLaw(2e-7, 10.0)}
    schedules = [Table((0.0, 20.0, 21.0, 60.0), (f, f, x * f, f)) for f, x in
                 ((force, 0.2), (0.5 * force, 1.5), (force, 0.0), (0.7 * force, 1.0))]  # fmt: skip
    return {
        "schedules": [replace(base, load=Load(OMEGA, q), **laws) for q in (*schedules, force)],
        "displacements": [
            replace(base, load=Load(OMEGA, displacement=d), **laws)
            for d in (0.02, 0.05, Table((0.0, 30.0, 50.0, 60.0), (0.05, -0.01, -0.01, 0.06)))
        ],
        "speeds": [
            replace(base, load=Load(omega, force), **laws)
            for omega in (OMEGA, Table((0.0, 25.0, 60.0), (0.0, 4.0, 1.0)), 0.5)
        ],
        "moduli": [
            replace(base, lower=replace(base.lower, young=e), upper=replace(base.upper, young=u),
                    **laws)
            for e, u in ((1e4, 1e5), (2e3, 2e5), *OWN)
        ],
        "ends": [replace(base, time=replace(base.time, until=t, tolerance=1e-5 / t), **laws)
                 for t in (1.0, 30.0, 200.0)],
        "sudden": [replace(base, time=replace(base.time, tolerance=tolerance), **laws,
                           load=Load(OMEGA, Table((0.0, 19.0, 19.001, 60.0), (0.1 * force, 0.1 *
                                     force, force, force))))
                   for tolerance in (1e-6, 2.5e-6, 1e-5)],
    }  # fmt: skip


def crowned(flat):
    """Contact grows, of loads that need unlike numbers of corrections."""
    r = np.linspace(28.5, 31.5, 13)
    face = tuple((float(x), float(y)) for x, y in zip(r, -((r - 30.0) ** 2) / 40.0, strict=True))
    base = replace(flat, upper=replace(flat.upper, face=face))
    cases = of_laws(base, "two bodies", 6)
    loads = (Load(OMEGA, f * base.load.force) for f in (0.02, 30.0))
    return [*cases, *cases[:3], *(replace(cases[0], load=load) for load in loads)]


def cones(flat):
    rings = Rings(CONTACT, (1e4, 1e5), degrees=10.0)
    base = replace(ring_case(rings, Mesh(16), ADAPTIVE), output=Output())
    upper = NonLocalLaw(3e-8, 20.0, length=0.1)
    return [replace(case, wear_upper=upper) for case in of_laws(base, "memory", 4)]


def layers(flat):
    """Some are worn through, at interfaces of their own."""
    base = read_case(CASES / "wear_through.toml", {"mesh.contact_elements": 16, "time.end": 60.0})
    keys = ("lower.layers[0].thickness", "lower.layers[0].wear.k", "lower.layers[0].wear.p0",
            "wear.lower.k")  # fmt: skip
    numbers = [(3e-3, 1e-8, 0.0, 1e-7), (3e-4, 4e-8, 60.0, 3e-7), (2e-4, 3e-8, 100.0, 1e-6),
               (3e-4, 2e-8, 20.0, 5e-8)]  # fmt: skip
    return [base.replace(dict(zip(keys, each, strict=True))) for each in numbers]


def ends(cases, pair, **how):
    """Return steps made and last state of each case; all must end."""
    last = {}

    def observe(snapshot):
        for i in np.flatnonzero(snapshot.finished):
            last[int(snapshot.numbers[i])] = (
                int(snapshot.progress.steps[i]), one(snapshot.state, i)
            )  # fmt: skip

    assert simulate(cases, ALONE, pair=pair, observers=[observe], **how).failures == {}
    return [last[i] for i in range(len(cases))]


def check(cases, pair):
    """All at once, two at a time and each alone: the same steps, and numbers to 1e-9."""
    together, by_two = ends(cases, pair), ends(cases, pair, most_together=2)
    for i, case in enumerate(cases):
        steps, alone = ends([case], pair)[0]
        for other_steps, other in (together[i], by_two[i]):
            assert other_steps == steps
            assert other.time == alone.time
            for name in ("wear", "rates", "worn", "energy"):
                found, exact = np.asarray(getattr(other, name)), np.asarray(getattr(alone, name))
                assert np.abs(found - exact).max() <= 1e-9 * np.abs(exact).max(), name
            exact = alone.contact.pressure
            assert np.abs(other.contact.pressure - exact).max() <= 1e-9 * exact.max()
    return [state for _, state in together]


@pytest.mark.parametrize(
    ("name", "stepping"),
    [
        ("two bodies", "adaptive"), ("power", "adaptive"), ("table", "adaptive"),
        ("memory", "implicit"), ("distance", "explicit"), ("non-local", "adaptive"),
        ("user", "adaptive"), ("object", "adaptive"), ("no wear", "adaptive"),
    ],
)  # fmt: skip
def test_laws_and_schemes(flat, pair, name, stepping):
    check(of_laws(replace(flat, time=STEPPINGS[stepping]), name, 3), pair)


@pytest.mark.parametrize("name", ["schedules", "displacements", "speeds", "moduli", "ends",
                                  "sudden"])  # fmt: skip
def test_loads(flat, pair, name):
    check(loads(flat)[name], pair)


@pytest.mark.parametrize("shape", [crowned, cones, layers])
def test_shapes(flat, shape, caplog):
    """Contact that grows, on slopes, and wear through layers."""
    cases = shape(flat)
    last = check(cases, assemble(cases[0], ALONE))
    if shape is layers:
        assert {bool(np.isfinite(state.through[0])) for state in last} == {True, False}
    assert not caplog.records  # such as of histories that cannot step together


def test_times_of_output_do_not_disturb(flat, pair):
    """Each history passes its own times; it goes on as if it had not been asked."""
    plain = of_laws(flat, "threshold", 3)
    asked = [
        replace(case, output=Output(times=tuple(np.linspace(0.0, 60.0, 4 + 3 * i)[1:].tolist())))
        for i, case in enumerate(plain)
    ]
    for (_, mine), (_, also) in zip(ends(asked, pair), ends(plain, pair), strict=True):
        assert mine.wear == pytest.approx(also.wear, rel=1e-9)


@dataclass(frozen=True)
class Spoilt(ThresholdLaw):
    """Fails in the histories whose threshold is 13 MPa, after some time."""

    def rate(self, p, at):
        """Raise, for all at once, if such a history is among them."""
        p0 = self._line(at)[1]
        if (np.broadcast_to(p0, p.shape)[np.broadcast_to(at.time, p.shape) > 5.0] == 13.0).any():
            raise LawError("no such material")
        return super().rate(p, at)


def test_one_that_fails_does_not_disturb_the_others(flat, pair):
    """Nobody can tell which it is: batches are halved until it is alone."""
    thresholds = zip(of_laws(flat, "threshold", 7), (0, 13, 20, 13, 0, 5, 30), strict=True)
    cases = [replace(case, wear_lower=Spoilt(1e-7, float(p0))) for case, p0 in thresholds]
    shown, last = [], {}

    def observe(snapshot):
        shown.append(len(snapshot.numbers))
        for i in np.flatnonzero(snapshot.finished):
            last[int(snapshot.numbers[i])] = one(snapshot.state, i)

    failures = simulate(cases, ALONE, pair=pair, observers=[observe]).failures
    assert sorted(failures) == [1, 3]
    assert all("no such material; in step" in str(error) for error in failures.values())
    assert sorted(last) == [0, 2, 4, 5, 6]
    assert max(shown) == 7
    good = [cases[i] for i in sorted(last)]
    for state, (_, exact) in zip(map(last.get, sorted(last)), ends(good, pair), strict=True):
        assert state.wear == pytest.approx(exact.wear, rel=1e-9)


def test_an_observer_that_fails_ends_all(flat, pair):
    """A step that was seen by some observers is no step to try once more."""
    times = []

    def observe(snapshot):
        times.append(snapshot.state.time.copy())
        if len(times) == 3:
            raise MemoryError("no room")

    cases = of_laws(replace(flat, time=STEPPINGS["implicit"]), "threshold")
    with pytest.raises(MemoryError):
        simulate(cases, ALONE, pair=pair, observers=[observe])
    assert [set(each) for each in times] == [{0.0}, {2.0}, {4.0}]


def test_those_worn_too_far_leave(flat, pair):
    cases = of_laws(flat, "threshold", 6)
    cases[2] = replace(cases[2], wear_lower=ThresholdLaw(3e-2))  # to half of its height
    finished = []
    see = [lambda s: finished.extend(s.numbers[s.finished].tolist())]
    failures = simulate(cases, ALONE, pair=pair, observers=see).failures
    assert list(failures) == [2]
    assert "worn off lower" in str(failures[2])
    assert sorted(finished) == [0, 1, 3, 4, 5]
    with pytest.raises(ComputationError, match="worn off lower"):
        simulate_one(cases[2], ALONE, pair=pair)


def test_who_goes_with_whom_depends_on_the_case_alone(flat):
    key = batch_key(flat)
    assert key == batch_key(replace(flat, friction=0.3, wear_lower=ThresholdLaw(3e-7, 1.0)))
    assert key != batch_key(replace(flat, wear_upper=ArchardLaw(1e-7)))
    assert key != batch_key(replace(flat, time=STEPPINGS["implicit"]))
    assert key != batch_key(replace(flat, load=Load(OMEGA, displacement=0.1)))
    lengths = [replace(flat, wear_lower=NonLocalLaw(1e-7, length=x)) for x in (0.1, 0.2)]
    assert len(set(map(batch_key, lengths))) == 2
    for alone in (
        replace(flat, mesh=replace(flat.mesh, geometry="updated")),
        replace(flat, output=Output(boundary="last")),
    ):
        assert batch_key(alone) is None
