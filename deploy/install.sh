#!/bin/sh
# Inside an image that is being built:
#   install.sh builder           installs what builds the rooms
#   install.sh packages ROOM...  installs what the rooms of a service need from a package registry
#   install.sh rooms ROOM...     installs the rooms themselves into /rooms, which is laid over the packages
set -eu

# A build argument that was not given arrives as nothing or as an empty value; pip must not see the latter.
for name in PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST PIP_DEFAULT_TIMEOUT TORCH_INDEX_URL; do
    eval "value=\${$name:-}"
    [ -n "$value" ] || unset "$name"
done
# The certificates that the machine trusts which builds the image, where it brought them along.
if [ -f /source/deploy/certificates/builder.pem ]; then
    export PIP_CERT=/source/deploy/certificates/builder.pem
fi
export PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_PROGRESS_BAR=off

# pip is in an environment of its own, so that it is not in the image.
pip=/opt/builder/bin/pip
into_image="$pip --python /opt/athrl/bin/python"

what=$1
shift
case $what in
builder)
    $pip install --quiet --constraint constraints.txt hatchling
    ;;
packages)
    python3 deploy/dependencies.py "$@" >/tmp/requirements.txt
    # Of two builds of one version pip takes the one for processors, whose version ends in +cpu.
    $into_image install --constraint constraints.txt --requirement /tmp/requirements.txt \
        ${TORCH_INDEX_URL:+--extra-index-url "$TORCH_INDEX_URL"}
    ;;
rooms)
    for room in "$@"; do
        $pip wheel --quiet --no-deps --no-build-isolation --wheel-dir /tmp/rooms "./$room"
    done
    $into_image install --quiet --no-deps --prefix /rooms /tmp/rooms/*.whl
    ;;
*)
    echo "install.sh: what is '$what'? It is builder, packages or rooms." >&2
    exit 2
    ;;
esac
