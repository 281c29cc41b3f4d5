#!/bin/sh
# A wheel on a machine that has nothing: a fresh Debian root, Python and pipx in it and no compiler, annulus installed by
# one command, and what each step took. As root; needs debootstrap, for another machine also qemu-user-static with binfmt.
#
#   make wheels && sudo tools/wheel/fresh_root.sh amd64 bookworm /var/tmp/fresh
#   make wheels && sudo tools/wheel/fresh_root.sh arm64 trixie /var/tmp/fresh "reconstruct /root/scan --calibration .. -o /root/out"
#
# Every further argument is one more annulus command to run inside. A file or folder in FOLDER/give is laid into /root
# before. Not part of `make test`: it downloads some 400 MB and, emulated, takes an hour.
set -eu
[ $# -ge 3 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
arch=$1 suite=$2 folder=$3
shift 3
case $arch in amd64) machine=x86_64 ;; arm64) machine=aarch64 ;; *) echo "fresh_root.sh: $arch: expected amd64 or arm64" >&2; exit 2 ;; esac
here=$(cd "$(dirname "$0")/../.." && pwd)
wheel=$(ls -t "$here"/dist/annulus_pipe-*"_$machine.whl" 2>/dev/null | head -1) && [ -n "$wheel" ] || { echo "fresh_root.sh: no wheel: make wheels" >&2; exit 1; }
root=$folder/$suite-$arch
mirror=${MIRROR:-http://deb.debian.org/debian}
mkdir -p "$folder"

row() { printf '| %-60s | %8s | %s |\n' "$1" "$2" "$3"; }
row step seconds "what came of it"
row --- --- ---

if [ ! -e "$root/etc/made" ]; then
	rm -rf "$root"
	begun=$(date +%s)
	debootstrap --arch="$arch" --variant=minbase --include=python3,python3-venv,pipx,ca-certificates "$suite" "$root" "$mirror" >"$folder/debootstrap.log" 2>&1
	touch "$root/etc/made"
	row "debootstrap $suite $arch" $(($(date +%s) - begun)) "$(du -sm "$root" | cut -f1) MB"
fi

# A root of its own every time, made of the one kept; this machine's way to the network.
fresh=$folder/$suite-$arch.run
umount -R "$fresh/proc" "$fresh/dev/shm" "$fresh/dev/pts" "$fresh/dev" 2>/dev/null || true
rm -rf "$fresh"
cp -a "$root" "$fresh"
for file in /etc/resolv.conf /etc/hosts /etc/ssl/certs/ca-certificates.crt; do [ ! -e "$file" ] || cp -L "$file" "$fresh$file"; done
cp "$wheel" "$fresh/root/"
[ ! -d "$folder/give" ] || cp -r "$folder/give/." "$fresh/root/"
mount -t proc proc "$fresh/proc"
mount --bind /dev "$fresh/dev"
mount --bind /dev/pts "$fresh/dev/pts"
mount -t tmpfs tmpfs "$fresh/dev/shm"
trap 'umount "$fresh/dev/shm" "$fresh/dev/pts" "$fresh/dev" "$fresh/proc"' EXIT

inside() {
	chroot "$fresh" env -i PATH=/root/.local/bin:/usr/bin:/bin:/usr/sbin:/sbin HOME=/root LANG=C.UTF-8 \
		PIP_CERT=/etc/ssl/certs/ca-certificates.crt SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt sh -c "cd /root && $1"
}
step() { # words, command, what is said of it (a command)
	begun=$(date +%s) status=0
	inside "$2" >"$folder/$suite-$arch.last" 2>&1 || status=$?
	cat "$folder/$suite-$arch.last" >>"$folder/$suite-$arch.log"
	row "$1" $(($(date +%s) - begun)) "status $status; $(inside "$3" 2>/dev/null | tail -1 | cut -c1-110)"
}

: >"$folder/$suite-$arch.log"
name=$(basename "$wheel")
row "compilers" 0 "$(inside 'command -v gcc cc make clang || echo none')"
step "pipx install $name" "pipx install ./$name" 'echo "$(du -sm /root/.local/*/pipx/venvs/annulus-pipe /root/.local/pipx/venvs/annulus-pipe 2>/dev/null | head -1 | cut -f1) MB of environment, wheel $(stat -c %s annulus_pipe-*.whl) bytes"'
step "annulus --version" "annulus --version" "annulus --version"
step "annulus firmware info" "annulus firmware info" "annulus firmware info | head -3 | tr -s ' \\n' ' '"
step "annulus firmware flash" "annulus firmware flash" "annulus firmware flash 2>&1"
step "annulus head selftest --port native://" "annulus head selftest --port native:// --yes --edges 20 -o selftest" "grep -o kept selftest/selftest.html | wc -l"
for command in "$@"; do
	step "annulus $command" "annulus $command" "tail -1 /dev/null"
	tail -3 "$folder/$suite-$arch.last" | sed 's/^/    /'
done
