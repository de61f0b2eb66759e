# The actor and the router: protocol and driving with ONNX Runtime, no torch.
FROM debian:bookworm-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends ca-certificates python3 python3-venv \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv /opt/athrl \
    && useradd --uid 10001 --create-home athrl \
    && install --directory --owner athrl /var/cache/athrl /certificates/actor /certificates/router
ENV PATH=/opt/athrl/bin:$PATH PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/var/cache/athrl OMP_NUM_THREADS=1 SDL_VIDEODRIVER=dummy
STOPSIGNAL SIGTERM
# Healthy is an actor that takes part in the run.
HEALTHCHECK --interval=30s --timeout=20s --start-period=60s CMD ["athrl", "status", "--check", "actor"]
ENTRYPOINT ["athrl"]
CMD ["actor"]

# What the rooms need, in a layer that a change of code leaves as it is.
WORKDIR /source
COPY deploy/install.sh deploy/dependencies.py deploy/
COPY deploy/certificates deploy/certificates
COPY constraints.txt ./
ARG PIP_INDEX_URL
ARG PIP_EXTRA_INDEX_URL
ARG PIP_TRUSTED_HOST
ARG PIP_DEFAULT_TIMEOUT
COPY spaces/pyproject.toml spaces/
COPY protocol/pyproject.toml protocol/
COPY driving/pyproject.toml driving/
COPY services/actor/pyproject.toml services/actor/
COPY athrl/pyproject.toml athrl/
RUN deploy/install.sh dependencies spaces protocol driving services/actor athrl

# The rooms.
COPY spaces spaces
COPY protocol protocol
COPY driving driving
COPY services/actor services/actor
COPY athrl athrl
RUN deploy/install.sh rooms spaces protocol driving services/actor athrl
USER athrl
# The traffic's kernels are compiled here, not at every start; a processor of another kind compiles them again.
COPY deploy/warm_up.py deploy/
RUN python deploy/warm_up.py
