#!/usr/bin/env bash
# Makes the image debian:bookworm-slim out of Debian's packages where it can neither be found nor pulled.
set -euo pipefail

image=debian:bookworm-slim

if docker image inspect "$image" >/dev/null 2>&1; then
    exit 0
fi
if timeout 60 docker pull --quiet "$image" 2>/dev/null; then
    exit 0
fi
echo "$image cannot be pulled: making it with debootstrap"
if ! command -v debootstrap >/dev/null; then
    if [ "$(id -u)" -ne 0 ]; then
        echo "base-image.sh: debootstrap is missing: install it, or make $image available" >&2
        exit 1
    fi
    apt-get update --quiet=2
    apt-get install --quiet=2 --yes --no-install-recommends debootstrap
fi
if [ "$(id -u)" -ne 0 ]; then
    echo "base-image.sh: debootstrap has to be run as root: sudo deploy/base-image.sh" >&2
    exit 1
fi
folder=$(mktemp --directory)
trap 'rm -rf "$folder" "$folder.log"' EXIT
# The mirror is debootstrap's own unless DEBIAN_MIRROR names another.
debootstrap --variant=minbase bookworm "$folder" ${DEBIAN_MIRROR:+"$DEBIAN_MIRROR"} >"$folder.log" 2>&1 || {
    tail -n 20 "$folder.log" >&2
    exit 1
}
rm -rf "$folder"/var/cache/apt/archives/*.deb "$folder"/var/lib/apt/lists/* \
    "$folder"/usr/share/{doc,info,locale,man}/*
tar --directory "$folder" --numeric-owner --create . |
    docker import --change 'CMD ["bash"]' - "$image" >/dev/null
echo "made $image"
