#!/bin/bash
# Creates or completes the virtual environment:  tools/make_venv.sh PYTHON VENV
set -euo pipefail
python=$1 venv=$2
cd "$(dirname "${BASH_SOURCE[0]}")/.."

fail() {
    echo "setup: $1" >&2
    exit 1
}

command -v "$python" >/dev/null || fail "$python not found; install python3, or say which: make PYTHON=python3.12"
"$python" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 12))' ||
    fail "$("$python" --version) is outside 3.10 to 3.12; say another: make PYTHON=python3.12"
command -v c++ >/dev/null || fail "no C++ compiler; install one: apt install g++"
"$python" -c 'import os, sys, sysconfig; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' ||
    fail "the headers of $python are missing; install them: apt install python3-dev"

if [ ! -x "$venv/bin/python" ] || ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    "$python" -m venv "$venv" || fail "cannot create $venv; install the venv module: apt install python3-venv"
fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --requirement requirements.txt
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
"$venv/bin/python" tools/repair_cmake_exports.py
