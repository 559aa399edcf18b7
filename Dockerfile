# docker build -t mapmyworld . && docker run --rm -v "$PWD:/data" mapmyworld build /data/drive.bag -o /data/map.db
FROM python:3.12-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY mapmyworld mapmyworld
COPY cli cli
COPY formats formats
RUN python -m venv /opt/mapmyworld && /opt/mapmyworld/bin/pip install --no-cache-dir .

FROM python:3.12-slim
# What Open3D loads: meshes need it, nothing else does.
# Debian keeps no old versions: a pinned one would soon be gone.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
    libgl1 libegl1 libx11-6 libusb-1.0-0 libudev1 libidn2-0 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/mapmyworld /opt/mapmyworld
RUN useradd --create-home --uid 1000 mapper && mkdir /data && chown mapper /data
# By number: a cluster that refuses root cannot look the name up.
USER 1000
WORKDIR /data
# Compiled kernels are kept in the user's own folder, which is writable.
ENV PATH=/opt/mapmyworld/bin:$PATH NUMBA_CACHE_DIR=/home/mapper/.cache/numba
ENTRYPOINT ["mapmyworld"]
CMD ["--help"]
