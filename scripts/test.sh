#!/usr/bin/env bash
# Sets up what is missing, then checks style, types and imports, runs all tests on 1, 2 and 3 ranks and builds the site.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source scripts/setup.sh
# where the interfaces of a container do not reach each other, Open MPI 5 warns of it
export OMPI_MCA_btl_tcp_if_include=lo
# the programs that tests start are many: each would compile the whole package again
unset PYTHONDONTWRITEBYTECODE
ruff check .
ruff format --check .
lint-imports --no-cache
log="$(mktemp -d)"
# beside the tests, many of which wait for programs
{ mypy && bash scripts/docs.sh; } > "$log/site" 2>&1 &
site=$!
trap 'kill "$site" 2> /dev/null || true' EXIT
# limits are for hangs, not for load; there are more tests at once than cores, the slow ones first
timeout -k 5 2400 python -m pytest -q -n 3 --dist loadfile --no-loadscope-reorder
wait "$site" || { cat "$log/site"; exit 1; }
for ranks in 2 3; do
    echo "on $ranks ranks"
    # every rank reports: the first is enough where all went well
    timeout -k 5 900 mpirun -n "$ranks" python -m pytest -q --color=no --only-mpi tests/mpi > "$log/ranks" 2>&1 ||
        { cat "$log/ranks"; exit 1; }
    grep -a -m 1 passed "$log/ranks"
done
rm -r "$log"
