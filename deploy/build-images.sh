#!/usr/bin/env bash
# Builds the images of the services; `build-images.sh learner actor` builds only those. `build-images.sh prometheus`
# builds the one of the profile `monitoring`.
#
# TORCH=gpu builds athrl/learner:gpu, with what torch loads on a GPU. TORCH_INDEX_URL names an index of torch's builds
# for processors alone, whose learner is the smallest.
#
# What this machine's pip needs to reach a package registry goes into the build, and not into the images:
# PIP_INDEX_URL, PIP_EXTRA_INDEX_URL, PIP_TRUSTED_HOST, PIP_DEFAULT_TIMEOUT, the proxy variables, and the
# certificates that PIP_CERT or SSL_CERT_FILE names. BUILD_NETWORK=host builds in this machine's network.
set -euo pipefail
bundle=''
for file in "${PIP_CERT:-}" "${SSL_CERT_FILE:-}"; do # a relative path is one from here
    if [ -f "$file" ]; then
        bundle=$(realpath "$file")
        break
    fi
done
cd "$(dirname "$0")/.."

services=("$@")
[ ${#services[@]} -gt 0 ] || services=(actor evaluator learner)

version=$(sed -n 's/^version = "\(.*\)"$/\1/p' athrl/pyproject.toml)
revision=$(git rev-parse HEAD 2>/dev/null || echo unknown)

deploy/base-image.sh

# All images are of one moment: a change between two builds could give services that refuse each other's schema.
tree=$(mktemp --directory)
trap 'rm -rf "$tree"' EXIT
tar --create --exclude-vcs --exclude=__pycache__ --exclude=.venv --exclude='.*_cache' \
    .dockerignore constraints.txt deploy spaces protocol driving planners services athrl |
    tar --extract --directory "$tree"
cd "$tree"

certificates=deploy/certificates/builder.pem
if [ -n "$bundle" ]; then
    install --mode=644 "$bundle" "$certificates"
    touch --date=@0 "$certificates" # the time of a copy is no reason to build a layer again
fi

arguments=(--network "${BUILD_NETWORK:-default}")
for name in PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST PIP_DEFAULT_TIMEOUT \
    HTTP_PROXY HTTPS_PROXY NO_PROXY http_proxy https_proxy no_proxy; do
    [ -z "${!name:-}" ] || arguments+=(--build-arg "$name")
done

for name in TORCH TORCH_INDEX_URL; do
    [ -z "${!name:-}" ] || arguments+=(--build-arg "$name")
done
arguments+=(--build-arg "VERSION=$version" --build-arg "REVISION=$revision"
    --build-arg "BASE_DIGEST=$(docker image inspect --format '{{.Id}}' debian:bookworm-slim)")

tag=latest
[ "${TORCH:-cpu}" = cpu ] || tag=$TORCH
for service in "${services[@]}"; do
    if [ "$service" = prometheus ]; then
        echo "building athrl/prometheus ($SECONDS s)"
        docker build "${arguments[@]}" --tag athrl/prometheus deploy/monitoring
        continue
    fi
    echo "building athrl/$service:$tag ($SECONDS s)"
    docker build "${arguments[@]}" --file deploy/Dockerfile --target "$service" --tag "athrl/$service:$tag" .
done
docker image ls --filter reference='athrl/*' --format 'athrl: {{.Repository}}:{{.Tag}} {{.Size}}'
