#!/bin/sh
# Run a command with the caches of the tests in one folder, ORBIT_TEST_CACHE: Warp's kernels, code compiled by inductor and
# by fusion, parsed robots and wheels. Each cache has the version and the source in its keys; the processor, for which the
# code is made, is in the folder's name. Where the folder cannot be written or its disk is full, out/caches takes its place.
set -u
processor=$(uname -m)-$(grep -m1 -E '^(flags|Features)' /proc/cpuinfo 2>/dev/null | cksum | cut -d' ' -f1)

usable() {
    mkdir -p "$1" 2>/dev/null || { echo "cannot be made"; return 1; }
    ( : >"$1/.probe.$$" ) 2>/dev/null && rm -f "$1/.probe.$$" || { echo "cannot be written"; return 1; }
    free=$(df -Pk "$1" | awk 'NR == 2 { print $4 }')
    [ "$free" -ge 1048576 ] || { echo "has less than 1 GiB left"; return 1; }
}

folder=${ORBIT_TEST_CACHE:-$HOME/.cache/orbit-tests}/$processor
if ! why=$(usable "$folder"); then
    echo "caches: $folder $why; out/caches is used instead" >&2
    folder=$PWD/out/caches/$processor
fi
export ORBIT_CACHE_DIR="$folder/models" WARP_CACHE_PATH="$folder/warp" TORCHINDUCTOR_CACHE_DIR="$folder/inductor"
export PIP_CACHE_DIR="$folder/pip"
exec "$@"
