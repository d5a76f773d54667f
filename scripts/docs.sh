#!/usr/bin/env bash
# Builds the site into docs/_build/html, all of it anew: pages, API, laws and keys from the code, and the gallery,
# whose scripts run. Warnings are errors, and so are links that lead nowhere. No network is needed once
# the tools are there. With --install it only sees to the tools.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source scripts/setup.sh
if ! python -c 'import furo, latex2mathml, myst_parser, numpydoc, sphinx_copybutton, sphinx_gallery' 2>/dev/null; then
    echo "ringwear docs: Python packages for the site, a minute" >&2
    numpy="numpy==$(python -c 'import numpy; print(numpy.__version__)')"
    # what pip says is of interest only where it fails
    said="$(python -m pip install -q --disable-pip-version-check -e ".[docs]" "$numpy" 2>&1)" ||
        { echo "$said" >&2; echo "ringwear docs: pip could not install the packages" >&2; exit 1; }
fi
[ "${1:-}" != --install ] || exit 0
rm -rf docs/_build docs/generated
python -m sphinx -q -n -W --keep-going -b html docs docs/_build/html
python docs/extensions/check_links.py docs/_build/html
echo "docs/_build/html/index.html"
