"""Cases that a stop interrupted: result files with checkpoints, read as blocks."""

from pathlib import Path

import numpy as np

from ringwear_par.cases.files.keys import read_keys
from ringwear_par.errors import InputError
from ringwear_par.history.observers.balances import Balances
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.storage.checkpoints import restored
from ringwear_par.results.storage.result_files import open_result
from ringwear_par.results.stress_variables import point_columns, stress_rows
from ringwear_par.results.variables import TIMES_THROUGH
from ringwear_par.studies.definition.identities import case_id
from ringwear_par.studies.definition.texts import Texts
from ringwear_par.studies.storage.blocks import DAMAGE, INCOMPLETE, STATUS, Block
from ringwear_par.studies.storage.stored_variables import FIELDS


def read_interrupted(path: Path, in_study: bool) -> Block:
    """Return an interrupted case with its history so far.

    Parameters
    ----------
    path : of its file, whose name is the case's id.
    in_study : whether a study has a case of this name, which the file then has to be of.

    Raises
    ------
    InputError : the file is damaged, of another case, or cannot be read.
    """
    result = open_result(path)
    if in_study and _id_of(result.case) != path.stem:
        raise InputError(f"{path}: is of another case than its name says")
    try:
        restored(result)
        attributes, steps = result.attributes, len(result.step)
        whole = {name: np.array([attributes[name]]) for name in TIMES_THROUGH if name in attributes}
        stress = {}
        if result.stress is not None:
            stress = stress_rows(result.stress, result.histories["time"])
            whole |= {name: v[None] for name, v in point_columns(result.stress).items()}
        fields = {**result.profiles, **result.layers}
        deep = any(fields[name].ndim == 2 for name in FIELDS if name in fields)
        if not deep:
            fields = {name: v[None] if name in FIELDS else v for name, v in fields.items()}
        histories = HistoryColumns(
            offsets=np.array([0, steps]),
            steps=result.steps_made,
            histories=result.histories,
            profiles=fields,
            imbalance=np.array([Balances(**result.balances).worst]),
            flags=((),),
            seconds=np.array([float(attributes["seconds_stepping"])]),
            status=(STATUS[INCOMPLETE],),
            reason=("",),
            stress=stress,
            whole=whole,
        )
        return Block.of(
            histories, result.line, [path.stem], Texts.whole([result.case]),
            str(attributes["version"]), deep=deep, steps=result.step, path=path,
        )  # fmt: skip
    except DAMAGE as error:
        raise InputError(f"{path}: is damaged") from error


def _id_of(text: str) -> str:
    """Return the id of a case by its text, "" if it is no good text."""
    try:
        return case_id(read_keys(text))
    except DAMAGE:
        return ""
