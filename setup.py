"""The extension ``elasticity._rings``; all else is in pyproject.toml."""

import platform

from Cython.Build import cythonize
from setuptools import Extension, setup

# what lets loops be vectorised, one by one: -ffast-math would also make the linker set the process
# to flush small numbers to zero
FLAGS = ["-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"]
if platform.machine() in ("x86_64", "AMD64"):
    FLAGS.append("-mprefer-vector-width=512")

rings = Extension(
    "ringwear_par.elasticity._rings",
    ["ringwear_par/elasticity/_rings.pyx"],
    depends=["ringwear_par/elasticity/_rings.h"],
    include_dirs=["ringwear_par/elasticity"],
    extra_compile_args=FLAGS,
)
setup(ext_modules=cythonize([rings], build_dir="build"))
