#!/usr/bin/env bash
# Inside the chroot: a screen, and a Blender that waits for scenarios (blender_window.py).
#
#   start_blender.sh FOLDER WIDTH HEIGHT
#
# Its add-on is the repository's, or where MANIENT_ADDON names an installed one, that of the user's profile.
# All of it lives in a process namespace of its own, so that ending this script ends the screen,
# Blender and whatever Blender started; FOLDER/left_behind lists what Blender did not end itself.
set -euo pipefail

if [ "${1:-}" != --inside ]; then
  exec unshare --pid --fork --kill-child "$0" --inside "$@"
fi
folder=$2 width=$3 height=$4
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

mount -t proc proc /proc

mkfifo /tmp/display
Xvfb -displayfd 3 -screen 0 "${width}x${height}x24" -nolisten tcp 3>/tmp/display >/tmp/xvfb.log 2>&1 &
screen=$!
read -r number </tmp/display
export DISPLAY=":$number" LIBGL_ALWAYS_SOFTWARE=1

settings=()
if [ -z "${MANIENT_ADDON:-}" ]; then
  # Where Blender looks for add-ons, as it does when it reloads its scripts.
  mkdir -p /tmp/scripts/addons
  ln -s "$(cd "$here/../.." && pwd)/blender_manient" /tmp/scripts/addons/
  export BLENDER_USER_SCRIPTS=/tmp/scripts PYTHONDONTWRITEBYTECODE=1
  settings=(--factory-startup)
fi

status=0
blender "${settings[@]}" --enable-event-simulate --no-window-focus \
  --window-geometry 0 0 "$width" "$height" \
  --python "$here/inside/driver.py" -- "$folder" || status=$?
# The backtrace that Blender has written where it crashed.
cat /tmp/*.crash.txt >"$folder/crash" 2>/dev/null || rm -f "$folder/crash"

sleep 1
: >"$folder/left_behind"
for process in /proc/[0-9]*; do
  pid=${process#/proc/}
  if [ "$pid" != "$$" ] && [ "$pid" != "$screen" ]; then
    tr '\0' ' ' <"$process/cmdline" >>"$folder/left_behind" 2>/dev/null && echo >>"$folder/left_behind" || true
  fi
done
exit "$status"
