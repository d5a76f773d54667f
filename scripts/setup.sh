# Sets up what is missing for ringwear-par on Debian 12 or 13: packages, .venv, the package itself.
# Sourced by paper.sh and test.sh; by itself: `source scripts/setup.sh`, then type commands.
# Works as root and as an ordinary user; says in one sentence what it may not do itself.
# What a call that was interrupted has left, and what was copied here from elsewhere, is made anew.

if [ -z "${BASH_VERSION:-}" ]; then
    echo "ringwear setup: only bash can source this; here: bash scripts/setup.sh && . .venv/bin/activate" >&2
    return 1 2>/dev/null || exit 1
fi

ringwear_setup() {
    local top python packages missing package made wanted said
    local mark="# ringwear-par: mpirun as root, more ranks than cores, one thread a rank"
    top="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
    python=/usr/bin/python3
    packages="python3-venv python3-petsc4py python3-petsc4py-real python3-mpi4py python3-scipy openmpi-bin libopenblas0-pthread"
    if [ -n "${PYTHONPATH:-}" ]; then
        echo "ringwear setup: PYTHONPATH=$PYTHONPATH is set aside: it would come before .venv" >&2
        unset PYTHONPATH
    fi

    missing=""
    for package in $packages; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "install ok installed" ||
            missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        local install="apt-get install -y --no-install-recommends$missing"
        local sudo=""
        if [ "$(id -u)" -ne 0 ]; then
            sudo -n true 2>/dev/null || {
                echo "ringwear setup: Debian packages are missing and you may not install them; ask for: sudo $install" >&2
                return 1
            }
            sudo="sudo -n"
        fi
        echo "ringwear setup: 1 of 3: Debian's packages$missing" >&2
        # first what an installation that was interrupted has left
        $sudo dpkg --configure -a >/dev/null 2>&1
        { $sudo apt-get update -qq && $sudo env DEBIAN_FRONTEND=noninteractive $install >/dev/null; } ||
            { echo "ringwear setup: '$sudo $install' failed" >&2; return 1; }
    fi

    # .venv names its place and its Python, so it cannot be moved or copied
    made="$top/.venv/ringwear-par"
    wanted="$top $("$python" --version) $(cat "$top/pyproject.toml" "$top/scripts/setup.sh" | cksum)"
    if [ "$(cat "$made" 2>/dev/null)" != "$wanted" ]; then
        if [ ! -w "$top" ]; then
            echo "ringwear setup: $top is not yours to write in; clone the repository to a folder of your own" >&2
            return 1
        fi
        rm -f "$made"
        echo "ringwear setup: 2 of 3: a virtual environment, $top/.venv" >&2
        "$python" -m venv --clear --system-site-packages "$top/.venv" ||
            { echo "ringwear setup: '$python -m venv $top/.venv' failed" >&2; return 1; }
        # Debian keeps petsc4py beside its PETSc, out of Python's sight
        echo "import glob, sys; sys.path += sorted(glob.glob('/usr/lib/petscdir/petsc3*/*-real/lib/python3/dist-packages'))[-1:]" \
            > "$("$top/.venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/debian-petsc.pth"
        "$top/.venv/bin/python" -c 'from petsc4py import PETSc' ||
            { echo "ringwear setup: Debian's petsc4py does not load" >&2; return 1; }
        # petsc4py and scipy of Debian 12 are built for numpy 1
        local numpy="numpy"
        case "$("$python" -c 'import numpy; print(numpy.__version__)')" in 1.*) numpy="numpy<2" ;; esac
        echo "ringwear setup: 3 of 3: Python packages, a minute or two" >&2
        # what pip says is of interest only where it fails
        said="$("$top/.venv/bin/pip" install -q --disable-pip-version-check -e "$top[test]" "$numpy" 2>&1)" ||
            { echo "$said" >&2; echo "ringwear setup: pip could not install the Python packages" >&2; return 1; }
        # conda's mpirun, for one, cannot start what is built with Debian's
        printf '#!/bin/sh\nexec /usr/bin/mpirun "$@"\n' > "$top/.venv/bin/mpirun"
        chmod +x "$top/.venv/bin/mpirun"
        cat >> "$top/.venv/bin/activate" <<ACTIVATE

$mark
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
export OMPI_MCA_hwloc_base_binding_policy=none PRTE_MCA_hwloc_default_binding_policy=none
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1
# a rank that waits leaves its core to others: there may be more ranks than cores
export OMPI_MCA_mpi_yield_when_idle=1
# ranks use this machine's loopback interface: where others do not reach each other, those of
# containers for one, Open MPI 5 warns of it. For ranks on several machines:
# unset OMPI_MCA_btl_tcp_if_include
export OMPI_MCA_btl_tcp_if_include=lo
ACTIVATE
        echo "$wanted" > "$made"
    fi
    source "$top/.venv/bin/activate"
}

ringwear_setup
