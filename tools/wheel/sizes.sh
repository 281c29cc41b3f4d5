#!/bin/sh
# What an environment of the wheel takes on the disk: the base, and with each extra.   make wheels && tools/wheel/sizes.sh
set -eu
here=$(cd "$(dirname "$0")/../.." && pwd)
wheel=$(ls -t "$here"/dist/annulus_pipe-*"_$(uname -m).whl" | head -1)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
echo "| extra | MB | packages | files of annulus itself, MB |"
echo "|---|---|---|---|"
for extra in base $(sed -n '/^\[project.optional-dependencies\]/,/^\[project.scripts\]/s/^\([a-z0-9]*\) = .*/\1/p' "$here/pyproject.toml"); do
	rm -rf "$scratch/venv"
	python3 -m venv --without-pip "$scratch/venv"
	"$here/.tools/bin/uv" pip install --quiet --link-mode copy --python "$scratch/venv/bin/python" \
		"annulus-pipe$([ "$extra" = base ] || echo "[$extra]") @ file://$wheel"
	packages=$(echo "$scratch"/venv/lib/python3*/site-packages)
	echo "| $extra | $(du -sm "$scratch/venv" | cut -f1) | $(ls -d "$packages"/*.dist-info | wc -l) | $(du -sm "$packages/annulus_pipe" | cut -f1) |"
done
