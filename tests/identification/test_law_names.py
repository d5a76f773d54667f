"""Names of laws, by which predictions and running tests refuse a case of another law."""

from parts import law_names
from paths import PAPER

import ringwear_par as rw


def test_names_tell_laws_of_layers_and_users_apart(tmp_path):
    layer = {"thickness": 2e-3, "young": 1e5, "poisson": 0.3, "wear": {"law": "archard", "k": 3e-9}}
    names = []
    for power in "12":
        (tmp_path / "law.py").write_text(f"def rate(p, v, k):\n    return k * p**{power} * v\n")
        law = {
            "wear.lower.law": "user",
            "wear.lower.file": str(tmp_path / "law.py"),
            "wear.lower.p0": None,
            "lower.layers": [layer],
        }
        names.append(law_names(rw.read_case(PAPER, law)))
    assert [name["lower.layers[0].wear"] for name in names] == ["archard", "archard"]
    assert names[0]["wear.lower"].split()[0] == names[1]["wear.lower"].split()[0] == "user"
    assert names[0] != names[1]
