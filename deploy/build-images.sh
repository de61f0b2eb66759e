#!/usr/bin/env bash
# Builds the images of the services; `build-images.sh learner actor` builds only those.
#
# What this machine's pip needs to reach a package registry goes into the build, and not into the images:
# PIP_INDEX_URL, PIP_EXTRA_INDEX_URL, PIP_TRUSTED_HOST, PIP_DEFAULT_TIMEOUT, the proxy variables, and the
# certificates that PIP_CERT or SSL_CERT_FILE names. BUILD_NETWORK=host builds in this machine's network.
set -euo pipefail
cd "$(dirname "$0")/.."

services=("$@")
[ ${#services[@]} -gt 0 ] || services=(learner actor evaluator)

deploy/base-image.sh

# All images are of one moment: a change between two builds could give services that refuse each other's schema.
tree=$(mktemp --directory)
trap 'rm -rf "$tree"' EXIT
tar --create --exclude-vcs --exclude=__pycache__ --exclude=.venv --exclude='.*_cache' \
    .dockerignore constraints.txt deploy spaces protocol driving planners services athrl |
    tar --extract --directory "$tree"
cd "$tree"

certificates=deploy/certificates/builder.pem
for bundle in "${PIP_CERT:-}" "${SSL_CERT_FILE:-}"; do
    if [ -f "$bundle" ]; then
        install --mode=644 "$bundle" "$certificates"
        touch --date=@0 "$certificates" # the time of a copy is no reason to build a layer again
        break
    fi
done

arguments=(--network "${BUILD_NETWORK:-default}")
for name in PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST PIP_DEFAULT_TIMEOUT \
    HTTP_PROXY HTTPS_PROXY NO_PROXY http_proxy https_proxy no_proxy; do
    [ -z "${!name:-}" ] || arguments+=(--build-arg "$name")
done

for service in "${services[@]}"; do
    echo "building athrl/$service"
    docker build "${arguments[@]}" --file "deploy/$service.Dockerfile" --tag "athrl/$service" .
done
