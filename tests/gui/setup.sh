#!/usr/bin/env bash
# Build the folder in which the GUI tests run: Debian's Blender 5.2 with a virtual screen and software OpenGL.
#
#   tests/gui/setup.sh            build what is missing; nothing to do the second time (under a second)
#   tests/gui/setup.sh --check    only say whether the folder is complete: exit status 0 or 1
#
# TG4MM_BLENDER_ROOT   the folder (default /var/tmp/tg4mm/blender-5.2); some 1.5 GB, never read by anything else
# TG4MM_DEBIAN_MIRROR  where the packages come from. Debian's sid moves on: should it hold a later Blender, take a
#                      day when it had 5.2, http://snapshot.debian.org/archive/debian/<yyyymmdd>T000000Z/
#
# Interrupted, it goes on where it was: the base system is made under another name and renamed, and apt keeps
# what it has downloaded. Mounts are made in a mount namespace of their own, so they end with the command.
set -euo pipefail

ROOT=${TG4MM_BLENDER_ROOT:-/var/tmp/tg4mm/blender-5.2}
MIRROR=${TG4MM_DEBIAN_MIRROR:-http://deb.debian.org/debian}
BLENDER=5.2
SPACE_MB=3000 # while the packages' archives are there too
PACKAGES=(blender python3-numpy python3-cattr python3-requests # its add-on for extensions imports the last two
    xvfb libgl1-mesa-dri libegl1 libglx-mesa0 xdotool)
DONE="$ROOT/.tg4mm-complete"

fail() {
    echo "tests/gui/setup.sh: $*" >&2
    exit 2
}

check_machine() {
    [ "$(uname -s)" = Linux ] || fail "needs Linux; this is $(uname -s)"
    [ "$(id -u)" -eq 0 ] || fail "needs root, since it uses chroot; you are user $(id -un)"
    command -v unshare >/dev/null || fail "unshare is not installed: apt-get install util-linux"
    unshare --mount true 2>/dev/null || fail "this machine allows no mount namespaces (in a container: --privileged)"
    command -v mmdebstrap >/dev/null ||
        fail "mmdebstrap is not installed: apt-get install mmdebstrap debian-archive-keyring"
    mkdir -p "$(dirname "$ROOT")"
    local free
    free=$(df --output=avail -m "$(dirname "$ROOT")" | tail -n 1)
    [ "$free" -ge "$SPACE_MB" ] || fail "$(dirname "$ROOT") has $free MB free, and $SPACE_MB are needed"
}

# A Debian with apt and nothing else, some 15 seconds.
make_base() {
    [ -e "$ROOT" ] && return
    local partial="$ROOT.partial"
    rm -rf --one-file-system "$partial"
    echo "Debian sid from $MIRROR into $ROOT"
    # A snapshot's index is past its date. The locale and manual pages are not needed.
    mmdebstrap --quiet --mode=root --variant=apt --aptopt='Acquire::Check-Valid-Until "false"' \
        --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/doc/*' \
        sid "$partial" "$MIRROR" || fail "mmdebstrap could not make Debian sid from $MIRROR"
    mv "$partial" "$ROOT"
}

# Runs in a mount namespace of its own.
install_packages() {
    mount --bind /dev "$ROOT/dev"
    mount -t proc proc "$ROOT/proc"
    cp -L /etc/resolv.conf "$ROOT/etc/resolv.conf"
    printf '#!/bin/sh\nexit 101\n' >"$ROOT/usr/sbin/policy-rc.d" # start no services
    chmod 755 "$ROOT/usr/sbin/policy-rc.d"
    in_root() { chroot "$ROOT" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C DEBIAN_FRONTEND=noninteractive "$@"; }
    in_root dpkg --configure -a
    in_root apt-get update -qq
    in_root apt-get install -qq -y --no-install-recommends -o Acquire::Retries=3 -o APT::Keep-Downloaded-Packages=true \
        -o Dpkg::Use-Pty=0 "${PACKAGES[@]}"
    in_root apt-get clean
}

check_blender() {
    local found
    found=$(chroot "$ROOT" blender --version 2>/dev/null | sed -n 's/^Blender \([0-9.]*\).*/\1/p' | head -n 1)
    case "$found" in
    "$BLENDER".*) echo "$found" ;;
    *) fail "$ROOT holds Blender '${found:-none}', and $BLENDER is needed; remove the folder and set" \
        "TG4MM_DEBIAN_MIRROR to a snapshot of a day when Debian sid had it (see the top of this file)" ;;
    esac
}

main() {
    if [ "${1:-}" = --check ]; then
        [ -e "$DONE" ] || { echo "no Blender in $ROOT; run tests/gui/setup.sh as root" && exit 1; }
        echo "Blender $(cat "$DONE") in $ROOT"
        exit 0
    fi
    [ -e "$DONE" ] && { echo "Blender $(cat "$DONE") is in $ROOT" && exit 0; }
    check_machine
    make_base
    echo "Blender and a virtual screen, about 1.3 GB"
    local log="$ROOT/var/log/tg4mm-install.log"
    unshare --mount --propagation private bash "$0" --install >"$log" 2>&1 || {
        tail -n 20 "$log" >&2
        fail "apt could not install; all of it is in $log. Run it again to go on"
    }
    local version
    version=$(check_blender)
    echo "$version" >"$DONE"
    echo "Blender $version is in $ROOT"
}

if [ "${1:-}" = --install ]; then install_packages; else main "$@"; fi
