"""The laws that a case file may name, one file each."""

from collections.abc import Mapping

from ringwear_par.wear.law import Law
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.non_local import NonLocalLaw
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.table import TableLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.laws.user import UserLaw

_ALL: tuple[type[Law], ...] = (
    ThresholdLaw,
    ArchardLaw,
    PowerLaw,
    TableLaw,
    RunningInLaw,
    NonLocalLaw,
    UserLaw,
)

#: by the name that ``law`` of a case file gives them
LAWS: Mapping[str, type[Law]] = {law.name: law for law in _ALL}
