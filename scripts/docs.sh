#!/usr/bin/env bash
# Builds the site into docs/_build/html, all of it anew: pages, API, laws and keys from the code, and the gallery,
# whose scripts run. Warnings are errors, and so are links that lead nowhere. No network is needed once
# the tools are there; they come without the package, which tests beside this use.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source scripts/setup.sh
python -c 'import furo, latex2mathml, myst_parser, numpydoc, sphinx_copybutton, sphinx_gallery' 2> /dev/null ||
    python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"])' | xargs python -m pip install -qq --no-compile
rm -rf docs/_build docs/generated
python -m sphinx -q -n -W --keep-going -b html docs docs/_build/html
python docs/extensions/check_links.py docs/_build/html
echo "docs/_build/html/index.html"
