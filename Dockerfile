# CPU image by default. With CUDA: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu130
# Use: docker run --rm -v "$PWD/runs:/work/runs" lfref train experiment=demo

FROM python:3.11-slim AS build
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN python -m venv /opt/lfref
ENV PATH=/opt/lfref/bin:$PATH PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /source
COPY constraints.txt ./
# The largest layer first: it changes only with the pins. A local version (2.13.0+cpu) wins over the plain one.
RUN pip install --extra-index-url "$TORCH_INDEX" --constraint constraints.txt torch
COPY pyproject.toml README.md LICENSE ./
COPY lfref lfref
COPY conf conf
COPY sweeps sweeps
RUN pip install --extra-index-url "$TORCH_INDEX" --constraint constraints.txt '.[export]'

FROM python:3.11-slim
RUN useradd --create-home --uid 1000 lfref && mkdir /work && chown lfref /work
COPY --from=build /opt/lfref /opt/lfref
ENV PATH=/opt/lfref/bin:$PATH
USER lfref
WORKDIR /work
# Whether it can do what it is for: a light field is simulated and refocused.
HEALTHCHECK --interval=10m --timeout=2m --start-period=2m CMD \
    lfref simulate n_fields=1 scene.camera.size=[48,64] outputs=[views] output=/tmp/health/scene overwrite=true && \
    lfref refocus /tmp/health/scene/simulated_s0_e0_000 slopes=[0] output=/tmp/health/stack overwrite=true
ENTRYPOINT ["lfref"]
CMD ["--help"]
