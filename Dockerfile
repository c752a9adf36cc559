# DOLFINx and the package, on Debian 13 (DOLFINx 0.9) or, with --build-arg DEBIAN=sid, on Debian's newest. The default command
# draws figure 1 into a mounted folder:
#   docker build -t dolfinx_mortar_al . && docker run --rm -v "$PWD/results:/results" dolfinx_mortar_al
ARG DEBIAN=trixie
FROM debian:${DEBIAN}-slim

COPY debian-packages.txt /tmp/
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        $(sed 's/#.*//' /tmp/debian-packages.txt) \
    && rm -rf /var/lib/apt/lists/* /tmp/debian-packages.txt

# One thread per rank, Open MPI startable as root, without a network and on more ranks than cores
ENV OMP_NUM_THREADS=1 \
    OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_btl=self,sm \
    PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe \
    MPLBACKEND=Agg \
    PYTHONPATH=/opt/dolfinx_mortar_al

COPY . /opt/dolfinx_mortar_al
WORKDIR /opt/dolfinx_mortar_al
RUN python3 -m compileall -q .
CMD ["python3", "demos/two_beams.py", "--output", "/results"]
