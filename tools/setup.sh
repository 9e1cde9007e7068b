#!/bin/sh
# Set-up: a virtual environment in .venv with the locked packages, and Mesa's EGL where nothing draws without it.
set -eu
python=$1

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "synthcam needs Python 3.11 or newer; try: make install PYTHON=python3.12" >&2
    exit 2
}
[ -x .venv/bin/python ] || "$python" -m venv .venv || {
    echo "python has no venv module; type: sudo apt-get install python3-venv" >&2
    exit 2
}
.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .

# The last word is synthcam's own: a frame drawn, or one line that names what is missing.
if ! .venv/bin/synthcam doctor >/dev/null 2>&1; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        apt-get update -qq && apt-get install -qq -y --no-install-recommends \
            libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri libopengl0 >/dev/null
    fi
    .venv/bin/synthcam doctor >/dev/null
fi
