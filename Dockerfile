# The command line, for the CPU:
#   docker build -t lfref .
#   docker run --rm -v "$PWD:/work" lfref refocus LIGHT_FIELD output=out
# With CUDA: --build-arg TORCH_INDEX=https://download.pytorch.org/whl/cu130

# The tag is for people; the digest decides.
ARG PYTHON=python:3.11-slim@sha256:9c900dea9e8fb7e16277c179b555cc72d29a352dbc33cff48ad5a0412fd5bfc7

FROM ${PYTHON} AS build
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN python -m venv /opt/lfref
ENV PATH=/opt/lfref/bin:$PATH PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /source
COPY constraints.txt ./
# The largest layer first: it changes only with the pins. A local version (2.13.0+cpu) wins over the plain one.
RUN pip install --extra-index-url "$TORCH_INDEX" --constraint constraints.txt torch
COPY pyproject.toml README.md LICENSE ./
COPY site/index_page.py site/
COPY lfref lfref
COPY conf conf
COPY sweeps sweeps
RUN pip install --extra-index-url "$TORCH_INDEX" --constraint constraints.txt '.[all]'

FROM ${PYTHON} AS cpu
ARG REVISION=""
RUN useradd --create-home --uid 1000 lfref && mkdir /work && chown lfref /work
COPY --from=build /opt/lfref /opt/lfref
# Machine code of the loops, for the processors of this machine and their kind, which any user may read and add to.
ENV PATH=/opt/lfref/bin:$PATH NUMBA_CACHE_DIR=/opt/lfref/loops
RUN lfref simulate n_fields=1 scene.camera.size=[48,64] outputs=[views] output=/tmp/warm/scene && \
    for method in shift_and_sum_antialiased separable_wiener blockwise_wiener; do \
    lfref refocus /tmp/warm/scene/simulated_s0_e0_000 method=$method disparity=true output=/tmp/warm/$method || exit 1; \
    done && rm -r /tmp/warm && chmod -R a+rwX /opt/lfref/loops
USER lfref
WORKDIR /work
LABEL org.opencontainers.image.title="lfref" \
      org.opencontainers.image.description="Light-field refocusing, classical and learned" \
      org.opencontainers.image.licenses="MIT" \
      org.opencontainers.image.revision="$REVISION"
ENTRYPOINT ["lfref"]
CMD ["--help"]
