"""The extensions ``elasticity._rings`` and ``contact._rows``; all else is in pyproject.toml."""

import platform

from Cython.Build import cythonize
from setuptools import Extension, setup

# loops that are vectorised, with sums in any order of numbers that are finite; one by one:
# -ffast-math would also make the linker set the process to flush small numbers to zero
FLAGS = ["-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"]
FLAGS += ["-fno-signed-zeros", "-fassociative-math", "-freciprocal-math", "-ffinite-math-only"]
# counters that never overflow, unlike Python's own flags: a third of the time
FLAGS += ["-fno-wrapv", "-funroll-loops"]
# names for debuggers take a third of the time that compiling takes
FLAGS += ["-g0"]
if platform.machine() in ("x86_64", "AMD64"):
    FLAGS.append("-mprefer-vector-width=512")


def extension(room: str, name: str) -> Extension:
    """Return the extension of a Cython file and the C header of its name."""
    path = f"ringwear_par/{room}"
    return Extension(
        f"ringwear_par.{room}.{name}",
        [f"{path}/{name}.pyx"],
        depends=[f"{path}/{name}.h"],
        include_dirs=[path],
        extra_compile_args=FLAGS,
    )


setup(
    ext_modules=cythonize(
        [extension("elasticity", "_rings"), extension("contact", "_rows")], build_dir="build"
    ),
    options={"build_ext": {"parallel": True}},  # two compilers at once
)
