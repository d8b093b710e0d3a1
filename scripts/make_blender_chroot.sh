#!/usr/bin/env bash
# Put a real Blender (Debian trixie's 4.3) into a folder of its own, to test against the program
# that artists run and not only against the bpy wheels.
#
#   sudo scripts/make_blender_chroot.sh [DIR]     # default: build/blender-chroot
#
# Needs root and a Debian-family machine with its package mirror in reach: about two minutes and 2 GB.
# Running it again on a finished folder does nothing.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
target=${1:-$here/build/blender-chroot}
suite=trixie
packages=blender,python3-numpy,xvfb,xauth,imagemagick,libgl1-mesa-dri,libegl1,fonts-dejavu-core,x11-utils,xdotool

if [ -e "$target/.complete" ]; then
  echo "real Blender is ready in $target"
  exit 0
fi
if [ "$(id -u)" -ne 0 ]; then
  echo "make_blender_chroot.sh: root is needed to build a Debian folder; run it with sudo" >&2
  exit 1
fi
if ! command -v debootstrap >/dev/null; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends debootstrap >/dev/null
fi

# The machine's own mirror, from either form of apt's sources. On an Ubuntu these name none of Debian's.
mirror=${DEBIAN_MIRROR:-$(
  {
    sed -nE 's/^URIs:[[:space:]]*([^[:space:]]+).*/\1/p' /etc/apt/sources.list.d/*.sources 2>/dev/null || true
    sed -nE 's/^deb[[:space:]]+(\[[^]]*\][[:space:]]+)?([^[:space:]]+).*/\2/p' /etc/apt/sources.list /etc/apt/sources.list.d/*.list 2>/dev/null || true
  } | grep -m 1 -E '/debian/?$' || true
)}
if [ -z "$mirror" ]; then
  echo "make_blender_chroot.sh: found no Debian mirror in this machine's apt sources; name one in DEBIAN_MIRROR" >&2
  exit 1
fi

if [ -e "$target" ] && [ ! -e "$target/.blender-chroot" ] && [ -n "$(ls -A "$target")" ]; then
  echo "make_blender_chroot.sh: $target is not empty and not of our making; name another folder" >&2
  exit 1
fi
if grep -q " $(realpath -m "$target")/" /proc/mounts; then
  echo "make_blender_chroot.sh: something is mounted below $target; unmount it first" >&2
  exit 1
fi
rm -rf "$target"
mkdir -p "$target"
touch "$target/.blender-chroot"
log=$(mktemp)
if ! debootstrap --variant=minbase --include="$packages" "$suite" "$target" "$mirror" >"$log" 2>&1; then
  tail -n 20 "$log" >&2
  [ -f "$target/debootstrap/debootstrap.log" ] && tail -n 20 "$target/debootstrap/debootstrap.log" >&2
  echo "make_blender_chroot.sh: debootstrap failed" >&2
  exit 1
fi
rm -f "$log"
rm -rf "$target"/var/cache/apt/archives/*.deb
touch "$target/.complete"
echo "real Blender is ready in $target: $(chroot "$target" blender --version 2>/dev/null | head -n 1)"
