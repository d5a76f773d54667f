"""The folder of a prediction: all draws, the picture of their band, the numbers."""

from collections.abc import Callable
from pathlib import Path

from ringwear_par.files.folders import (
    BAND,
    DRAWS,
    PREDICTION,
    check_folder,
    json_bytes,
    new_files,
    write_contents,
)
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.pictures.style import picture
from ringwear_par.prediction.prediction import Prediction
from ringwear_par.results.storage.hdf5 import atomic_hdf5, write_variable

FILES = (DRAWS, BAND, PREDICTION)


def prepare(folder: Path) -> None:
    """Refuse a folder that cannot be written, and say where its outcome is replaced. On one rank.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    check_folder(folder, FILES, "predict")
    announce_replacement(folder / PREDICTION)


def files_line(folder: Path) -> str:
    """Return the line about the files of a folder, and about the command to type next."""
    return closing_line(folder, FILES)


def save(prediction: Prediction, folder: Path) -> None:
    """Write all files; prediction.json, which says that it is whole, the last. On one rank.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    with new_files(folder, FILES, "predict"):
        with atomic_hdf5(folder / DRAWS) as (file, _):
            file.attrs.update(prediction.attributes)
            for variable, values in prediction.variables():
                write_variable(file, variable, values)
        contents: dict[str, Callable[[], bytes | None]] = {
            BAND: lambda: picture(prediction.plot, str(folder / BAND)),
            PREDICTION: lambda: json_bytes(prediction.to_dict()),
        }
        write_contents(folder, contents)
