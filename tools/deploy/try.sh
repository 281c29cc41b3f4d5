#!/bin/bash
# The image built and run where no registry is: on a base of debootstrap, by buildah; then a scheduler, two workers and
# a client of it in a network of their own, each as user 10001 on a root that cannot be written.
#
#   sudo tools/deploy/try.sh /var/tmp/image                     # downloads 700 MB, takes 4 GB; remove FOLDER after
#   sudo tools/deploy/try.sh /var/tmp/image SCAN                # a scan folder, reprocessed by them as well
#
# As root; needs debootstrap, buildah, iproute2 and openssl. Not part of `make test`.
set -euo pipefail
here=$(cd "$(dirname "$0")/../.." && pwd)
[ $# -ge 1 ] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
folder=$(realpath -m "$1") scan=${2:-}
image=${IMAGE:-localhost/annulus:try} # IMAGE=..: one that buildah has in FOLDER, which is not built again
mkdir -p "$folder"

row() { printf '| %-58s | %8s | %s |\n' "$1" "$2" "$3"; }
since() { awk -v a="$1" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }'; }
ours() { STORAGE_DRIVER=overlay BUILDAH_ISOLATION=chroot buildah --root "$folder/store" --runroot "$folder/run" "$@"; }

# As a container runtime does it: the image's environment and entry point, its root read-only, /scratch of its own,
# /mnt with what it is given; no capability left and none to be had.
contained() { # name, command ..
	mkdir -p "$folder/scratch/$1" && chmod 1777 "$folder/scratch/$1"
	FOLDER=$folder unshare -m --propagation private bash -c '
		root=$FOLDER/root.ro scratch=$FOLDER/scratch/$1; shift
		mkdir -p "$root"
		mount --bind "$(cat "$FOLDER/mounted")" "$root" && mount -o remount,ro,bind "$root"
		mount -t proc proc "$root/proc" && mount --rbind /dev "$root/dev"
		mount --bind "$scratch" "$root/scratch" && mount --bind "$FOLDER/give" "$root/mnt"
		mapfile -t image <"$FOLDER/environment"
		exec env -i "${image[@]}" chroot --userspec=10001:10001 --groups= "$root" \
			setpriv --no-new-privs --inh-caps=-all sh -c "cd /scratch && exec begin \"\$@\"" - "$@"' - "$@"
}

build() {
	if [ ! -e "$folder/base/etc/made" ]; then
		begun=$(date +%s.%N)
		debootstrap --variant=minbase bookworm "$folder/base" "${MIRROR:-http://deb.debian.org/debian}" >"$folder/debootstrap.log" 2>&1
		mkdir -p "$folder/base/usr/local/share/ca-certificates" # what this machine believes, the base does
		cp /usr/local/share/ca-certificates/*.crt "$folder/base/usr/local/share/ca-certificates/" 2>/dev/null || true
		rm -f "$folder"/base/var/cache/apt/archives/*.deb
		touch "$folder/base/etc/made"
		row "debootstrap --variant=minbase bookworm" "$(since "$begun")" "$(du -sm "$folder/base" | cut -f1) MB"
	fi
	if ! ours inspect --type image localhost/debian:12-slim >/dev/null 2>&1; then
		made=$(ours from scratch) && ours add -q "$made" "$folder/base" / >/dev/null
		ours commit -q --format docker "$made" localhost/debian:12-slim >/dev/null && ours rm "$made" >/dev/null
	fi
	begun=$(date +%s.%N)
	[ -n "${IMAGE:-}" ] || (cd "$here" && ours bud --format docker --layers --ignorefile tools/deploy/Dockerfile.dockerignore -f tools/deploy/Dockerfile \
		--build-arg BASE=localhost/debian:12-slim --build-arg COMMIT="$(git rev-parse --short=8 HEAD)" -t "$image" .) >"$folder/build.log" 2>&1 ||
		{ tail -5 "$folder/build.log" >&2; exit 1; }
	made=$(ours from "$image")
	ours mount "$made" >"$folder/mounted"
	ours inspect --type image --format '{{range .OCIv1.Config.Env}}{{println .}}{{end}}' "$image" | grep . >"$folder/environment"
	row "image of $(ours inspect --type image --format '{{index .OCIv1.Config.Labels "org.opencontainers.image.revision"}}' "$image")" "$(since "$begun")" "$(du -smx "$(cat "$folder/mounted")" | cut -f1) MB"
	rm -rf "$folder/give" "$folder/scratch" && mkdir -p "$folder/give"
	"$here/tools/deploy/certificates.sh" "$folder/give/tls" >/dev/null
	[ -z "$scan" ] || cp -r "$scan" "$folder/give/scan"
	chown -R 10001:10001 "$folder/give"
}

files() { echo "--tls-ca-file=/mnt/tls/ca.pem --tls-cert=/mnt/tls/$1.pem --tls-key=/mnt/tls/$1.key"; }
worker() { contained "$1" dask worker tls://10.9.0.1:8786 --host=10.9.0.1 --worker-port=9000:9099 --nthreads=1 --no-nanny --memory-limit=0 --death-timeout=60 --local-directory=/scratch --dashboard-address=127.0.0.1:0 $(files worker) >"$folder/$1.log" 2>&1; }

# TLS 1.3 says no only after the greeting: whoever leaves at once does not hear it.
knock() { sleep 2 | openssl s_client -connect 10.9.0.1:8786 "$@" 2>&1 || true; }

inside() {
	ip link set lo up && ip addr add 10.9.0.1/24 dev lo
	row "touch /opt/annulus/x" "" "$(contained first sh -c 'touch /opt/annulus/x 2>&1; id -u' | tr '\n' ';')"
	begun=$(date +%s.%N) said=$(contained second annulus --version)
	row "annulus --version, the loops laid out first" "$(since "$begun")" "$said"
	begun=$(date +%s.%N) said=$(contained second annulus reprocess --help | tail -3 | tr -s ' \n' ' ')
	row "annulus reprocess --help" "$(since "$begun")" "$said"
	contained bare timeout 60 dask scheduler --protocol=tcp --host=10.9.0.1 --dashboard-address=127.0.0.1:8787 >"$folder/bare.log" 2>&1 || true
	said=$(grep -m1 -o "encryption required.*" "$folder/bare.log" || true)
	row "dask scheduler --protocol=tcp --host=10.9.0.1" "" "${said:-NOT REFUSED}"
	begun=$(date +%s.%N)
	contained scheduler dask scheduler --protocol=tls --port=8786 --dashboard-address=127.0.0.1:8787 $(files scheduler) >"$folder/scheduler.log" 2>&1 &
	until contained scheduler healthy 2>/dev/null; do sleep 0.2; done
	row "dask scheduler --protocol=tls: healthy" "$(since "$begun")" "$(ss -ltn | awk '/8786|8787/ { print $4 }' | tr '\n' ' ')"
	worker one & # as machine.yaml has it
	worker two &
	begun=$(date +%s.%N)
	until grep -q 'Registered to' "$folder/one.log" && grep -q 'Registered to' "$folder/two.log"; do sleep 0.2; done
	row "two workers: registered" "$(since "$begun")" "$(grep -ho 'tls://10.9.0.1:90[0-9][0-9]' "$folder/one.log" "$folder/two.log" | sort -u | tr '\n' ' ')"
	said=$(knock -tls1_3 | grep -m1 -o 'alert certificate required' || true)
	row "without a certificate" "" "${said:-LET IN}"
	said=$(knock -tls1_2 -cert "$folder/give/tls/client.pem" -key "$folder/give/tls/client.key" | grep -m1 -o 'alert protocol version' || true)
	row "TLS 1.2, with one" "" "${said:-LET IN}"
	if [ -n "$scan" ]; then
		given=(/mnt/scan)
		[ ! -e "$scan/calibration.json" ] || given+=(--calibration=/mnt/scan/calibration.json)
		mkdir "$folder/give/season" && chown 10001 "$folder/give/season"
		begun=$(date +%s.%N) status=0
		contained client annulus reprocess "${given[@]}" --out=/mnt/season --engine=dask --scheduler=tls://10.9.0.1:8786 --tls-ca=/mnt/tls/ca.pem \
			--tls-cert=/mnt/tls/client.pem --tls-key=/mnt/tls/client.key --progress=json >"$folder/client.log" 2>&1 || status=$?
		row "annulus reprocess by two workers" "$(since "$begun")" "status $status; $(grep -v '"done"' "$folder/client.log" | tail -1 | cut -c1-90)"
		begun=$(date +%s.%N) status=0
		contained alone annulus reprocess "${given[@]}" --out=/scratch/season --workers 1 >"$folder/alone.log" 2>&1 || status=$?
		row "the same by one process of one container" "$(since "$begun")" "status $status; cloud.ply and stations.csv $(cmp "$folder/give/season/scan/cloud.ply" "$folder/scratch/alone/season/scan/cloud.ply" && cmp "$folder/give/season/scan/stations.csv" "$folder/scratch/alone/season/scan/stations.csv" && echo the same bytes || echo OTHERS)"
	fi
	row "memory, MB: scheduler, workers" "" "$(ps -eo rss=,args= | awk '/[d]ask (scheduler --protocol|worker tls:..10.9.0.1)/ && /opt.annulus.bin.python/ { printf "%d ", $1 / 1024 }')"
}

if [ "${TRY_INSIDE:-}" = yes ]; then
	inside
else
	row step seconds "what came of it"
	row --- --- ---
	build
	TRY_INSIDE=yes unshare -n -p -f --mount-proc "$0" "$@" # whose end is the end of all that was begun in it
	ours umount --all >/dev/null && ours rm --all >/dev/null
fi
