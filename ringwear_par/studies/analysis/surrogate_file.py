"""``surrogate.h5``: a surrogate that is kept beside the results that it was made of."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.results.storage.hdf5 import (
    atomic_hdf5,
    read_array,
    read_number,
    read_text,
    reading,
)
from ringwear_par.results.variables import Variable
from ringwear_par.studies.analysis.predictions import Surrogate, unit_of
from ringwear_par.studies.analysis.regression import Part, Response, forms_for
from ringwear_par.studies.analysis.responses import most_of

SURROGATE = "surrogate.h5"
_SOFTWARE, _WHAT = "ringwear-par surrogate 3", "a surrogate of a sweep"
#: arrays (keys,) of a part
_OF_KEYS = ("low", "high", "logarithmic", "stretches")


def write_surrogate(path: Path, made: Surrogate, identity: str) -> None:
    """Write a surrogate by rename. On one rank.

    Parameters
    ----------
    identity : of the results.

    Raises
    ------
    OSError, RingwearError : the disk.
    """
    with atomic_hdf5(path) as (file, _):
        file.attrs.update({
            "software": _SOFTWARE, "results": identity, "cases": made.cases, "done": made.done,
            "text_keys": json.dumps(made.text_keys), "parts": len(made.parts),
        })  # fmt: skip
        for number, part in enumerate(made.parts):
            group = file.create_group(f"part_{number}")
            group.attrs.update(keys=json.dumps(part.keys), texts=json.dumps(part.texts))
            for name in _OF_KEYS:
                group[name] = getattr(part, name).astype(float)
            group["points"] = part.points
            for name, response in part.responses.items():
                group[name] = response.values
                group[name].attrs.update(
                    form=response.form, error=response.error, form_error=response.form_error,
                    shape=json.dumps(response.shape), units=unit_of(name),
                )  # fmt: skip
            group.attrs["responses"] = json.dumps(list(part.responses))


def read_surrogate(path: Path, identity: str) -> Surrogate | None:
    """Return a surrogate that was kept; None if it is one of other results.

    Raises
    ------
    InputError : the file is damaged.
    """
    with reading(path, _SOFTWARE, _WHAT) as file:
        if read_text(file.attrs["results"]) != identity:
            return None
        parts = []
        for number in range(int(read_number(file.attrs["parts"]))):
            group = file[f"part_{number}"]
            keys = _words(group.attrs["keys"])
            sizes = {"key": len(keys)}
            low, high, logarithmic, stretches = (
                _finite(group, name, ("key",), sizes) for name in _OF_KEYS
            )
            points = _finite(group, "points", ("case", "key"), sizes)
            responses = {}
            for name in _words(group.attrs["responses"]):
                about = group[name].attrs
                response = Response(
                    _finite(group, name, ("case", f"column of {name}"), sizes),
                    read_text(about["form"]), float(read_number(about["error"])),
                    float(read_number(about["form_error"])),
                    tuple(map(int, json.loads(read_text(about["shape"])))), most_of(name),
                )  # fmt: skip
                if response.form not in forms_for(response.values):
                    raise ValueError(name)
                response.values.reshape(-1, *response.shape)
                responses[name] = response
            texts, by_log = _words(group.attrs["texts"]), logarithmic > 0.0
            if not (low < high).all() or not (low[by_log] > 0.0).all():
                raise ValueError("low")
            parts.append(Part(texts, keys, low, high, by_log, points, stretches, responses))
        return Surrogate(
            _words(file.attrs["text_keys"]), parts, int(read_number(file.attrs["cases"])),
            int(read_number(file.attrs["done"])),
        )  # fmt: skip


def _words(value: Any) -> tuple[str, ...]:
    return tuple(map(read_text, json.loads(read_text(value))))


def _finite(group: Any, name: str, dimensions: tuple[str, ...], sizes: dict[str, int]) -> Any:
    array = read_array(group, Variable(name, dimensions, "", ""), sizes)
    if not np.isfinite(array).all():
        raise ValueError(name)
    return array
