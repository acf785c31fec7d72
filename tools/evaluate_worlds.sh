#!/bin/bash
# The paper's tables:  tools/evaluate_worlds.sh DIR [--seeds N] [--tables NAME,...]
# Writes DIR/report.html and docs/results.md; worlds and runs that DIR has already are used again. The nodes run
# once on a world of each kind; they run again where a source is newer than their report.
set -euo pipefail
for preset in tabletop synthetic-planar synthetic-nonplanar four-round triple-infinity; do
    nodes="$1/nodes/$preset-0"
    if [ ! -e "$nodes/report.json" ] ||
        [ -n "$(find neuse neuse_msgs neuse_*_node bags -newer "$nodes/report.json" -type f \
            -regex '.*\.\(py\|msg\|srv\|yaml\|safetensors\)' -print -quit)" ]; then
        rm -rf "$nodes"
        ./run.sh neuse_bags demo --preset "$preset" --out "$nodes"
    fi
done
exec python -m neuse.evaluation.tables --out "$1" --docs docs/results.md "${@:2}"
