#!/bin/sh
# Inside an image that is being built: `install.sh dependencies ROOM...` installs what the rooms need,
# `install.sh rooms ROOM...` the rooms themselves.
set -eu

# A build argument that was not given arrives as nothing or as an empty value; pip must not see the latter.
for name in PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST PIP_DEFAULT_TIMEOUT; do
    eval "value=\${$name:-}"
    [ -n "$value" ] || unset "$name"
done
# The certificates that the machine trusts which builds the image, where it brought them along.
if [ -f /source/deploy/certificates/builder.pem ]; then
    export PIP_CERT=/source/deploy/certificates/builder.pem
fi
export PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1

what=$1
shift
case $what in
dependencies)
    python deploy/dependencies.py "$@" >/tmp/requirements.txt
    pip install --quiet --constraint constraints.txt hatchling --requirement /tmp/requirements.txt
    ;;
rooms)
    paths=
    for room in "$@"; do paths="$paths ./$room"; done
    # shellcheck disable=SC2086  # one argument a room
    pip install --quiet --no-deps --no-build-isolation $paths
    ;;
*)
    echo "install.sh: what is '$what'? It is dependencies or rooms." >&2
    exit 2
    ;;
esac
