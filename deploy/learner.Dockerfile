# The learner: protocol and planners with torch, no simulator.
FROM debian:bookworm-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends ca-certificates python3 python3-venv \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv /opt/athrl \
    && useradd --uid 10001 --create-home athrl \
    && install --directory --owner athrl /runs /certificates/authority /certificates/learner /certificates/actor \
        /certificates/evaluator /certificates/viewer /certificates/router
ENV PATH=/opt/athrl/bin:$PATH PYTHONUNBUFFERED=1
EXPOSE 7447
STOPSIGNAL SIGTERM
# Healthy is a learner that answers with the state of its run.
HEALTHCHECK --interval=30s --timeout=20s --start-period=60s CMD ["athrl", "status", "--check", "learner"]
ENTRYPOINT ["athrl"]
CMD ["learner", "--resume-if-present", "--set", "run.folder=/runs", "--set", "network.listen=tcp/0.0.0.0:7447"]

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
COPY planners/pyproject.toml planners/
COPY services/learner/pyproject.toml services/learner/
COPY athrl/pyproject.toml athrl/
RUN deploy/install.sh dependencies spaces protocol planners services/learner athrl

# The rooms.
COPY spaces spaces
COPY protocol protocol
COPY planners planners
COPY services/learner services/learner
COPY athrl athrl
RUN deploy/install.sh rooms spaces protocol planners services/learner athrl
USER athrl
