#!/bin/sh
# Process 1 of a namespace of its own: a virtual screen, the extension installed, Blender on the screen.
#
#   run_inside.sh ROOT FOLDER WIDTH HEIGHT      FOLDER as seen inside ROOT; session.py starts this
#
# Ends when its standard input does, that is with the process that started it, however that ends; and with
# process 1 ends all that it has started, and its mounts.
set -eu
root=$1 folder=$2 width=$3 height=$4

mount -t proc proc "$root/proc"
mount -t tmpfs tmpfs "$root/dev/shm"

inside() {
    chroot "$root" env -i PATH=/usr/bin:/bin HOME="$folder/home" LC_ALL=C.UTF-8 XDG_RUNTIME_DIR="$folder/home" \
        LIBGL_ALWAYS_SOFTWARE=1 BLENDER_USER_RESOURCES="$folder/resources" "$@"
}

status() { echo "$1" >"$root$folder/status.partial" && mv "$root$folder/status.partial" "$root$folder/status"; }

(
    exec </dev/null
    inside blender --command extension install-file -r user_default --enable "$folder/extension.zip" \
        >"$root$folder/install.log" 2>&1 || { status "not installed"; exit; }
    # The screen's number is chosen by the server and written to its descriptor 3.
    # What is on it lies in a file, Xvfb_screen0, which costs nothing to read; a pointer would be in it.
    inside Xvfb -displayfd 3 -screen 0 "${width}x${height}x24" -fbdir "$folder/screen" -nocursor -nolisten tcp \
        +extension GLX \
        3>"$root$folder/display" >"$root$folder/xvfb.log" 2>&1 &
    until [ -s "$root$folder/display" ]; do sleep 0.1; done
    status "started"
    inside DISPLAY=":$(cat "$root$folder/display")" blender --window-geometry 0 0 "$width" "$height" \
        --python "$folder/answering.py" -- "$folder" >"$root$folder/blender.log" 2>&1 || true
    status "ended"
) &

read -r _ || true
