#!/bin/bash
# The paper's tables:  tools/evaluate_worlds.sh DIR [--seeds N] [--tables NAME,...]
# Writes DIR/report.html and docs/results.md; worlds and runs that DIR has already are used again.
set -euo pipefail
exec python -m neuse.evaluation.tables --out "$1" --docs docs/results.md "${@:2}"
