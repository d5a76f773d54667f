"""A Spack package: copy it to ``packages/py_ringwear_par/package.py`` of a repository of yours."""

from spack.package import *
from spack_repo.builtin.build_systems.python import PythonPackage


class PyRingwearPar(PythonPackage):
    """Wear histories of ring-on-ring and ring-on-disc tests by boundary elements, MPI and PETSc."""

    license("BSD-3-Clause")
    # until there is a release: spack dev-build, or spack develop -p /path/to/clone
    version("0.2.0")

    # extras of pyproject.toml; Spack's py-pyevtk is too old for "export"
    variant("fit", default=True, description="posteriors of fits")
    variant("report", default=True, description="pages of runs, sweeps and fits")
    variant("sensitivity", default=True, description="sensitivity indices of sweeps")
    variant("xarray", default=True, description="results as xarray datasets")

    depends_on("python@3.11:", type=("build", "run"))
    depends_on("py-setuptools@77:", type="build")
    depends_on("py-numpy@1.25:", type=("build", "run"))
    depends_on("py-scipy@1.10:", type=("build", "run"))
    depends_on("py-h5py@3.7:", type=("build", "run"))
    depends_on("py-llvmlite@0.41:", type=("build", "run"))
    depends_on("py-numba@0.58:", type=("build", "run"))
    depends_on("py-mpi4py@3.1:", type=("build", "run"))
    depends_on("py-petsc4py@3.18:", type=("build", "run"))
    depends_on("petsc~complex+scalapack", type=("build", "run"))
    depends_on("py-tqdm@4.60:", type=("build", "run"))
    depends_on("py-matplotlib@3.6:", type=("build", "run"))
    depends_on("py-pint@0.22:", type=("build", "run"))
    depends_on("py-emcee@3.1:", type=("build", "run"), when="+fit")
    depends_on("py-bokeh@3.4:", type=("build", "run"), when="+report")
    depends_on("py-jinja2@3.1:", type=("build", "run"), when="+report")
    depends_on("py-salib@1.5:", type=("build", "run"), when="+sensitivity")
    depends_on("py-xarray@2024.1:", type=("build", "run"), when="+xarray")
    depends_on("py-h5netcdf@1.3:", type=("build", "run"), when="+xarray")
