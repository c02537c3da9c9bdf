# An engine, a world or any other command of FAME: docker run fame engine REX. Built for amd64; on arm64 it communicates
# over Zenoh (--middleware zenoh), since Cyclone DDS has no wheel there (docs/robot_computers.md#containers).
# BASE=debian@sha256:... pins the base; Debian keeps only the newest version of a package, so the base pins those too.
ARG BASE=debian:bookworm-slim
FROM ${BASE} AS build
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends python3-venv && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
RUN python3 -m venv /opt/fame && /opt/fame/bin/pip install --no-cache-dir --constraint .ci/constraints.txt '.[sim,dds,zenoh,view,metrics]'

FROM ${BASE}
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends python3 && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 1000 --create-home fame && install --directory --owner=fame /var/lib/fame
COPY --from=build /opt/fame /opt/fame
COPY models /mission/models
COPY examples /mission/examples
ENV PATH=/opt/fame/bin:$PATH PYTHONUNBUFFERED=1
USER 1000
WORKDIR /mission
VOLUME /var/lib/fame
# ROBOT names the engine of this container; other commands have none, and are healthy while they run.
HEALTHCHECK --interval=60s --timeout=25s --start-period=60s \
    CMD ["sh", "-c", "test -z \"$ROBOT\" || fame status \"$ROBOT\" --middleware \"${FAME_MIDDLEWARE:-dds}\" || exit 1"]
ENTRYPOINT ["fame"]
CMD ["--help"]
