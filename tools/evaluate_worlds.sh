#!/bin/bash
# Every world through the in-process pipeline:  tools/evaluate_worlds.sh DIR
# Worlds that are there are not simulated again; DIR/<world>/ gets what `neuse_bags run` writes.
set -euo pipefail
out=$1
mkdir -p "$out"
for world in tabletop synthetic-planar synthetic-nonplanar four-round triple-infinity; do
    bag="$out/$world.mcap"
    if [ ! -f "$bag" ]; then
        ./run.sh neuse_bags simulate "$world" --seed 0 --out "$out/$world.partial.mcap"
        mv "$out/$world.partial.mcap" "$bag"
    fi
    ./run.sh neuse_bags run "$bag" --out "$out/$world"
done
