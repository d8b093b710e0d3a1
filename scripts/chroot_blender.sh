#!/usr/bin/env bash
# Run a real Blender that lives in a chroot (make_blender_chroot.sh) on this repository.
#
#   sudo scripts/chroot_blender.sh CHROOT blender -b -P scripts/batch_fit.py -- ...
#
# Inside, the repository, the samples, the core's cache, the folders named in $CHROOT_BIND (colon-separated) and the
# Python $HANDFIT_PYTHON with its virtual environment stand at the same paths as outside; with CHROOT_SEALED=1
# only the last two of these. The mounts live in a private namespace: nothing to clean up, and runs do not see
# each other.
set -euo pipefail

if [ "$#" -lt 2 ] || [ ! -x "$1/usr/bin/blender" ]; then
  echo "usage: chroot_blender.sh CHROOT COMMAND [ARGS...] (CHROOT from make_blender_chroot.sh)" >&2
  exit 2
fi
if [ -z "${MANIENT_IN_NAMESPACE:-}" ]; then
  MANIENT_IN_NAMESPACE=1 exec unshare --mount --propagation private "${BASH_SOURCE[0]}" "$@"
fi

chroot_dir=$(cd "$1" && pwd)
shift
repo=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

bind() { # a folder, to the same path inside
  [ -d "$1" ] || return 0
  mkdir -p "$chroot_dir$1"
  mount --rbind "$1" "$chroot_dir$1"
}

mount -t proc proc "$chroot_dir/proc"
mount --rbind /dev "$chroot_dir/dev"
mount -t tmpfs tmpfs "$chroot_dir/tmp"
cache=${HANDFIT_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/handfit}
if [ -z "${CHROOT_SEALED:-}" ]; then
  bind "$repo"
  samples=${HANDFIT_SAMPLES:-$repo/../shared/samples}
  [ -d "$samples" ] && bind "$(cd "$samples" && pwd)"
  # The core keeps the landmark model there.
  bind "$cache"
fi
if [ -n "${HANDFIT_PYTHON:-}" ]; then
  # The environment, and the installation that it stands on.
  while read -r prefix; do
    case $prefix in
      /usr | /)
        echo "chroot_blender.sh: HANDFIT_PYTHON is the system's own Python, which would hide Blender's" >&2
        exit 2
        ;;
    esac
    bind "$prefix"
  done < <(
    "$HANDFIT_PYTHON" -c 'import sys; print(*dict.fromkeys((sys.base_prefix, sys.prefix)), sep="\n")'
  )
fi
IFS=: read -r -a extra <<<"${CHROOT_BIND:-}"
for folder in "${extra[@]}"; do bind "$folder"; done

here=$PWD
exec chroot "$chroot_dir" /usr/bin/env HOME=/tmp TMPDIR=/tmp HANDFIT_CACHE="$cache" \
  sh -c 'cd "$1" 2>/dev/null || cd /; shift; exec "$@"' sh "$here" "$@"
