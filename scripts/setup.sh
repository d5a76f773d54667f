# Sets up what is missing on Debian 12 or 13: Debian's packages, .venv, the package itself: `source scripts/setup.sh`.
# What is there stays: .venv is made anew only for another folder or Python, pip runs after a change of what it builds.
[ -n "${BASH_VERSION:-}" ] || { echo "ringwear setup: only bash can source this; here: bash scripts/setup.sh && . .venv/bin/activate" >&2; return 1; }

ringwear_setup() {
    local top venv missing="" package install sudo="" numpy="numpy"
    top="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
    venv="$top/.venv"
    for package in python3-venv python3-dev gcc python3-petsc4py python3-petsc4py-real python3-mpi4py python3-scipy openmpi-bin libopenblas0-pthread; do
        dpkg -s "$package" 2> /dev/null | grep -q "^Status: install ok installed" || missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        install="apt-get install -y --no-install-recommends$missing"
        echo "ringwear setup: Debian packages are missing: $install" >&2
        [ "$(id -u)" -eq 0 ] || { sudo -n true 2> /dev/null && sudo="sudo -n"; } || return 1
        { $sudo apt-get update -qq && DEBIAN_FRONTEND=noninteractive $sudo $install > /dev/null; } || return 1
    fi
    if [ "$(cat "$venv/made" 2> /dev/null)" != "$top $(/usr/bin/python3 -V)" ]; then
        /usr/bin/python3 -m venv --clear --system-site-packages "$venv" || return 1
        # Debian keeps petsc4py beside its PETSc, out of Python's sight
        echo "import glob, sys; sys.path += sorted(glob.glob('/usr/lib/petscdir/petsc3*/*-real/lib/python3/dist-packages'))[-1:]" \
            > "$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/debian-petsc.pth"
    fi
    if [ -n "$(find "$top"/{pyproject.toml,setup.py,ringwear_par/{elasticity/_rings,contact/_rows}.{h,pyx}} -newer "$venv/made" 2>&1)" ]; then
        echo "ringwear setup: Python packages into $venv, a minute or two" >&2
        # petsc4py and scipy of Debian 12 are built for numpy 1
        case "$(/usr/bin/python3 -c 'import numpy; print(numpy.__version__)')" in 1.*) numpy="numpy<2" ;; esac
        "$venv/bin/python" -m pip install -qq --no-compile -e "$top[test]" "$numpy" || return 1  # most modules stay unused
        echo "$top $(/usr/bin/python3 -V)" > "$venv/made"
    fi
    source "$venv/bin/activate"
    # more ranks than cores, wherever there is room (Open MPI 4 and 5), one thread a rank
    export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
    export OMPI_MCA_hwloc_base_binding_policy=none PRTE_MCA_hwloc_default_binding_policy=none
    export OMPI_MCA_mpi_yield_when_idle=1 OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
    [ "$(id -u)" -ne 0 ] || export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
}

ringwear_setup
