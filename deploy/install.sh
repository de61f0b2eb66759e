#!/bin/sh
# Inside an image that is being built:
#   install.sh builder        installs what builds the rooms
#   install.sh rooms          installs the rooms of each service into /rooms/SERVICE, which is laid over its packages,
#                             and writes what they need from a package registry to /requirements/SERVICE.txt
#   install.sh packages FILE  installs the requirements in FILE
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

# lay_rooms FOLDER ROOM...: installs rooms into the folder.
lay_rooms() {
    folder=$1
    shift
    wheels=$(mktemp --directory)
    for room in "$@"; do
        $pip wheel --quiet --no-deps --no-build-isolation --wheel-dir "$wheels" "./$room"
    done
    $into_image install --quiet --no-deps --prefix "$folder" "$wheels"/*.whl
}

what=$1
case $what in
builder)
    $pip install --quiet --constraint constraints.txt hatchling
    ;;
rooms)
    mkdir /rooms /requirements
    drive='spaces protocol driving athrl'
    learn='spaces protocol planners athrl'
    python3 deploy/dependencies.py $drive services/actor >/requirements/actor.txt
    python3 deploy/dependencies.py $drive services/evaluator >/requirements/evaluator.txt
    python3 deploy/dependencies.py $learn services/learner >/requirements/learner.txt
    # A copy with its times: compiled kernels belong to the file and the time of its last change.
    lay_rooms /rooms/actor $drive
    cp --archive /rooms/actor /rooms/evaluator
    lay_rooms /rooms/actor services/actor
    lay_rooms /rooms/evaluator services/evaluator
    lay_rooms /rooms/learner $learn services/learner
    ;;
packages)
    # Of two builds of one version pip takes the one for processors, whose version ends in +cpu.
    $into_image install --constraint constraints.txt --requirement "$2" \
        ${TORCH_INDEX_URL:+--extra-index-url "$TORCH_INDEX_URL"}
    ;;
*)
    echo "install.sh: what is '$what'? It is builder, rooms or packages." >&2
    exit 2
    ;;
esac
