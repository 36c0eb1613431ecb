#!/bin/sh
# install.sh VENV WHAT: make the virtual environment VENV when it is missing and install WHAT (. or .[dev]) into it,
# in the versions of constraints.txt; with uv when it is there and works, else with pip.
set -eu
venv=$1
what=$2
python=${PYTHON:-python3}

if ! command -v "$python" >/dev/null 2>&1 ||
    ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
    echo "topcli needs Python 3.11 or newer, and '$python' is not; say make PYTHON=/path/to/python3.11" >&2
    exit 2
fi

if command -v uv >/dev/null 2>&1; then
    { [ -x "$venv/bin/python" ] || uv venv --quiet --python "$python" "$venv"; } &&
        uv pip install --quiet --python "$venv/bin/python" --constraint constraints.txt --editable "$what" && exit 0
    echo "uv could not install; trying pip" >&2
fi

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv" || {
    rm -rf "$venv"
    echo "cannot make a virtual environment: install python3-venv (Debian, Ubuntu), or uv" >&2
    exit 2
}
"$venv/bin/python" -m pip --version >/dev/null 2>&1 || "$venv/bin/python" -m ensurepip --upgrade >/dev/null
echo "installing $what into $venv ..." >&2
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable "$what"
