"""What derivatives take: what ``scripts/benchmark.py --derivatives`` prints.

The paper's rings, 200 s, with respect to four numbers. The same histories are computed plain and
with derivatives, in turns, checks and results included; times are of this process alone, so that
others on the machine matter less, and the ratio, of which the median counts, is that of neighbours.
"Alone" is ``rw.simulate`` of the paper's case, "together" are as many cases as are given by
``rw.simulate_all``, drawn as for ``--ensembles``.
"""

import time
from collections.abc import Callable
from statistics import median

import benchmark_ensembles
from mpi4py import MPI

import ringwear_par as rw

#: what the derivatives are with respect to
KEYS = ("wear.lower.k", "wear.lower.p0", "load.pressure", "contact.friction")
_KINDS = ("adaptive", "200 implicit steps")


def _seconds(action: Callable[[], object]) -> float:
    begun = time.process_time()
    action()
    return time.process_time() - begun


def _ratio(action: Callable[[tuple[str, ...]], object], repeats: int) -> tuple[float, float]:
    """Return the time of plain histories, s, and what derivatives take on top, in that time."""
    action(KEYS)  # what is loaded or made once
    pairs = [(_seconds(lambda: action(())), _seconds(lambda: action(KEYS))) for _ in range(repeats)]
    plain = median(plain for plain, _ in pairs)
    return plain, median(differentiated / plain - 1.0 for plain, differentiated in pairs)


def measure(kind: str, count: int, elements: int, repeats: int) -> tuple[float, ...]:
    """Return plain time, s, and share of derivatives, alone and together."""
    alone = MPI.COMM_SELF
    case = rw.read_case(
        benchmark_ensembles.CASES / "paper.toml",
        {**benchmark_ensembles.KINDS[kind], "mesh.contact_elements": elements},
    )
    cases = benchmark_ensembles.cases_of(kind, count, elements)
    pair = rw.assemble(case, alone)
    return (
        *_ratio(lambda keys: rw.simulate(case, alone, pair=pair, derivatives=keys), 5 * repeats),
        *_ratio(lambda keys: rw.simulate_all(cases, alone, derivatives=keys), repeats),
    )


def print_table(count: int, elements: int, repeats: int) -> None:
    """Print all of it, of so many cases together."""
    print(f"{f'{elements} elements, {len(KEYS)} numbers':<30}{'alone, s':>10}{'on top':>8}", end="")
    print(f"{f'{count} together, s':>20}{'on top':>8}")
    for kind in _KINDS:
        one, more, many, many_more = measure(kind, count, elements, repeats)
        print(f"{kind:<30}{one:>10.3g}{more:>8.2f}{many:>20.3g}{many_more:>8.2f}", flush=True)
