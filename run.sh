#!/bin/bash
# Runs an executable of a package, as `ros2 run` does:  ./run.sh PACKAGE EXECUTABLE [ARGS]
if [ $# -lt 2 ]; then
    echo "usage: ./run.sh PACKAGE EXECUTABLE [ARGS]" >&2
    exit 2
fi
package=$1 executable=$2
shift 2
source "$(dirname "${BASH_SOURCE[0]}")/env.sh"

IFS=: read -ra prefixes <<<"${AMENT_PREFIX_PATH:-}"
for prefix in "${prefixes[@]}"; do
    [ -f "$prefix/share/ament_index/resource_index/packages/$package" ] || continue
    [ -x "$prefix/lib/$package/$executable" ] && exec "$prefix/lib/$package/$executable" "$@"
    echo "package $package has no executable $executable; it has: $(ls "$prefix/lib/$package" 2>/dev/null | xargs)" >&2
    exit 1
done
echo "package $package not found; build the workspace first: make setup" >&2
exit 1
