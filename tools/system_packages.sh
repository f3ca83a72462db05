#!/bin/sh
# Makes sure of what pip cannot install: `graphics`, a library to draw without a screen; `browser`, Chromium for the
# viewer's tests. Installs it where it may, with apt as root; elsewhere it says what is missing.
set -eu

missing=""
for part in "$@"; do
    case "$part" in
        graphics) ldconfig -p | grep -q -e libEGL.so.1 -e libOSMesa.so || missing="$missing libegl1 libegl-mesa0" ;;
        browser) command -v chromium > /dev/null || missing="$missing chromium" ;;
        *) echo "unknown part '$part': use graphics or browser" >&2; exit 2 ;;
    esac
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null; then
    apt-get update -qq
    # shellcheck disable=SC2086 - a list of packages
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing > /dev/null
else
    echo "note: not installed, and needed to draw pictures or test the viewer:$missing" >&2
    echo "      on Debian or Ubuntu: sudo apt-get install$missing" >&2
fi
