# docker build -t ringwear-par .
# docker run --rm -v "$PWD":/data ringwear-par mpirun -n 2 ringwear run case.toml -o run.h5
FROM debian:12-slim
RUN apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends python3-venv python3-dev gcc \
        python3-petsc4py python3-petsc4py-real python3-mpi4py python3-scipy openmpi-bin libopenblas0-pthread && rm -rf /var/lib/apt/lists/*
# Debian keeps petsc4py beside its PETSc; its petsc4py and scipy are built for numpy 1
RUN python3 -m venv --system-site-packages /opt/ringwear && ls -d /usr/lib/petscdir/petsc3*/*-real/lib/python3/dist-packages \
    > "$(/opt/ringwear/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/debian-petsc.pth"
COPY LICENSE pyproject.toml setup.py /src/
COPY docs/package.md /src/docs/
COPY ringwear_par /src/ringwear_par
RUN /opt/ringwear/bin/pip install --no-cache-dir "/src[explore,surrogate,xlsx]" "numpy<2" && rm -rf /src
ENV PATH=/opt/ringwear/bin:$PATH OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
RUN ringwear verify > /dev/null
RUN useradd --create-home tribologist
USER tribologist
WORKDIR /data
CMD ["ringwear", "info"]
