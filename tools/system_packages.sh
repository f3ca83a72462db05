#!/bin/sh
# Makes sure of what pip cannot install: `graphics`, a library to draw without a screen; `browser`, Chromium for the
# viewer's tests; `vulkan`, a Vulkan driver for machines without a graphics card, which SAPIEN's images need. Installs
# it where it may, with apt as root; elsewhere it says what is missing.
set -eu

backports=/etc/apt/sources.list.d/bookworm-backports.sources
missing=""
suite=""
for part in "$@"; do
    case "$part" in
        graphics) ldconfig -p | grep -q -e libEGL.so.1 -e libOSMesa.so || missing="$missing libegl1 libegl-mesa0" ;;
        browser) command -v chromium > /dev/null || missing="$missing chromium" ;;
        vulkan)
            if ! ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json > /dev/null 2>&1; then
                missing="$missing libvulkan1 mesa-vulkan-drivers"
                # Debian 12's own Mesa 22 lacks what SAPIEN needs; its backports have Mesa 25.
                if grep -q bookworm /etc/os-release 2> /dev/null; then suite=bookworm-backports; fi
            fi
            ;;
        *) echo "unknown part '$part': use graphics, browser or vulkan" >&2; exit 2 ;;
    esac
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null; then
    if [ -n "$suite" ] && [ ! -e "$backports" ]; then
        # The backports stand beside the release on the mirror that the machine already uses.
        mirror=$(apt-get indextargets --format '$(REPO_URI) $(CODENAME)' 'Created-By: Packages' |
            sed -n 's/ bookworm$//p' | head -n 1)
        printf 'Types: deb\nURIs: %s\nSuites: %s\nComponents: main\nSigned-By: %s\n' \
            "$mirror" "$suite" /usr/share/keyrings/debian-archive-keyring.gpg > "$backports"
    fi
    apt-get update -qq
    # shellcheck disable=SC2086 - a list of packages
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends ${suite:+-t "$suite"} $missing > /dev/null
else
    echo "note: not installed, and needed to draw pictures or test the viewer:$missing" >&2
    echo "      on Debian or Ubuntu: sudo apt-get install ${suite:+-t $suite}$missing" >&2
fi
