"""PETSc options: a prefix for each kind of solver; those with our prefixes must be used."""

import ctypes
import difflib
import itertools
import logging
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ringwear_par.errors import InputError, RingwearError, legible
from ringwear_par.files.text import read_text

if TYPE_CHECKING:
    from petsc4py import PETSc

log = logging.getLogger(__name__)

#: of the boundary element systems, of the contact problem, and of fits to measurements
BEM_PREFIX, CONTACT_PREFIX, FIT_PREFIX = "bem_", "contact_", "identify_"


def start_petsc(words: Sequence[str]) -> None:
    """Start PETSc with options of a command line. Collective on the world's communicator.

    Without effect where it has been started. Signals stay Python's own: checkpoints on SIGTERM,
    quiet ends of pipes.

    Raises
    ------
    InputError : they are no options, or PETSc does not accept them.
    RingwearError : there is no PETSc for Python, or none that serves.
    """
    _refuse_words(words)
    try:
        # MPI first: petsc4py from a wheel finds none by itself
        from mpi4py import MPI  # noqa: F401, I001
        import petsc4py

        with _listening() as heard:
            try:
                petsc4py.init(["ringwear", *words, "-no_signal_handler"])
                failure = None
            except RuntimeError as error:  # what PETSc's own are
                failure = error
        if failure is not None:
            reason = _reason(heard[0]) or str(failure)
            raise InputError(f"-- {legible(' '.join(words))}: PETSc does not accept it: {reason}")
        sys.stderr.write(heard[0])
        from petsc4py import PETSc
    except ImportError as error:
        raise RingwearError(
            f"PETSc for Python does not load ({error}): it comes with Debian's "
            "python3-petsc4py-real, with conda-forge's petsc4py (environment.yml), or built for a "
            "cluster's PETSc (see docs/howto/cluster.md)"
        ) from error
    if PETSc.ScalarType is not PETSc.RealType:
        raise RingwearError("PETSc for Python is a build with complex scalars; must be real")


def _refuse_words(words: Sequence[str]) -> None:
    """Refuse what is neither an option nor the value of one, and a file of options that is none."""
    before = ""
    for word in words:
        if re.match(r"--?[A-Za-z]", word) and word not in ("-inf", "-nan"):
            before = word
        elif not before:
            raise InputError(
                f"-- {legible(word)}: must be an option of PETSc, such as -contact_tao_monitor, "
                "and the value of one behind it"
            )
        else:
            if before == "-options_file":
                try:
                    read_text(Path(word))
                except InputError as error:
                    raise InputError(f"-options_file {error}") from error
            before = ""


@contextmanager
def _listening() -> Iterator[list[str]]:
    """Keep what C code says on standard error, whose text is in the list afterwards."""
    heard: list[str] = []
    sys.stderr.flush()
    with os.fdopen(os.memfd_create("petsc"), "w+b") as file:  # no disk, which may be full
        stderr = os.dup(2)
        try:
            os.dup2(file.fileno(), 2)
            yield heard
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            file.seek(0)
            heard.append(file.read().decode(errors="replace"))


def _reason(report: str) -> str:
    """Return the reason in PETSc's report of an error, "" for none."""
    lines = [line.partition("PETSC ERROR: ")[2] for line in report.splitlines()]
    start = next((i for i, line in enumerate(lines) if "Error Message" in line), len(lines))
    reason = itertools.takewhile(
        lambda line: line and not line.startswith(("WARNING!", "See ")), lines[start + 1 :]
    )
    return ": ".join(reason)


def set_from_options(solver: "PETSc.KSP | PETSc.TAO", prefix: str) -> None:
    """Let a solver read its PETSc options. Collective on the solver.

    Raises
    ------
    InputError : PETSc does not accept a value.
    """
    from petsc4py import PETSc

    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        raise InputError(
            f"-{prefix}... options: PETSc does not accept one of them (error {error.ierr}); types "
            "must be among those of this PETSc"
        ) from error


def _was_used(name: str) -> bool:
    # PetscOptionsUsed has no petsc4py call before 3.19
    from petsc4py import PETSc

    used = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value & 0xFF)


def reject_unused_options() -> None:
    """Check that every option with one of our prefixes was read by a solver. Not collective.

    Others are warned of: PETSc itself reads some of them, a few at its end only.

    Call when every kind of system was solved once: some options are read as late as that.

    Raises
    ------
    InputError : one sentence for each option.
    """
    from petsc4py import PETSc

    ours = (BEM_PREFIX, CONTACT_PREFIX, FIT_PREFIX)
    unused = [name for name in PETSc.Options().getAll() if not _was_used(name)]
    foreign = [name for name in unused if not name.startswith(ours)]
    unused = [name for name in unused if name.startswith(ours)]
    if foreign:
        log.warning(
            "-%s: no solver of this run reads it; names of their options begin with -%s, -%s, -%s",
            ", -".join(foreign), *ours,
        )  # fmt: skip
    if unused:
        raise InputError(
            *(
                f"-{name}: no solver of this run reads this PETSc option"
                f"{_nearest(name)}; must be one that {name.split('_')[0]}_ solvers know"
                for name in unused
            )
        )


def _nearest(name: str) -> str:
    known = [
        f"{CONTACT_PREFIX}tao_type", f"{CONTACT_PREFIX}tao_monitor", f"{CONTACT_PREFIX}tao_view",
        f"{CONTACT_PREFIX}ksp_type", f"{CONTACT_PREFIX}pc_type", f"{CONTACT_PREFIX}ksp_rtol",
        f"{BEM_PREFIX}ksp_type", f"{BEM_PREFIX}ksp_view", f"{BEM_PREFIX}pc_type",
        f"{FIT_PREFIX}tao_monitor", f"{FIT_PREFIX}tao_view",
    ]  # fmt: skip
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    return f" (did you mean -{near[0]}?)" if near else ""
