#!/bin/sh
# Makes sure the Debian packages behind the named needs are there; installs them where it may, says what to do where not.
set -eu

missing=""
want() { # package, test that is true when it is there
	sh -c "$2" >/dev/null 2>&1 || missing="$missing $1"
}

for need in "$@"; do
	case "$need" in
	python3-venv) want python3-venv 'python3 -c "import ensurepip, venv"' ;;
	gcc) want gcc 'command -v gcc' && want libc6-dev 'ls /usr/include/math.h' && want make 'command -v make' ;;
	clang) want clang 'command -v clang || command -v clang-14' ;;
	libclang-rt) want libclang-rt-14-dev 'ls /usr/lib/llvm-*/lib/clang/*/lib/linux/libclang_rt.fuzzer-*.a' ;;
	gcc-arm-none-eabi) want gcc-arm-none-eabi 'command -v arm-none-eabi-gcc' ;;
	nodejs) want nodejs 'command -v node' ;;
	npm) want npm 'command -v npm' ;;
	sigrok-cli) want sigrok-cli 'command -v sigrok-cli && ls /usr/share/libsigrokdecode/decoders/uart' ;;
	qemu-system-x86) want qemu-system-x86 'command -v qemu-system-x86_64' ;;
	busybox-static) want busybox-static 'command -v busybox && ! ldd "$(command -v busybox)"' ;;
	kmod) want kmod 'PATH=$PATH:/usr/sbin:/sbin command -v modprobe' ;;
	linux-image-amd64) want linux-image-amd64 'ls /boot/vmlinuz-*-amd64 | sed s,/boot/vmlinuz-,, | while read -r release; do
		find "/lib/modules/$release" -name "vivid.ko*" | grep . && break; done | grep .' ;; # the cloud kernel has no drivers
	gcc-aarch64-linux-gnu) want gcc-aarch64-linux-gnu 'command -v aarch64-linux-gnu-gcc' # wheels for a Pi
		want libc6-dev-arm64-cross 'ls /usr/aarch64-linux-gnu/include/string.h' ;;
	qemu-user-static) want qemu-user-static 'command -v qemu-aarch64-static' ;; # loops for a Pi, run here
	systemd) want systemd 'command -v systemd-analyze' ;;
	chromium) want chromium 'command -v chromium' ;;
	pango) want libpangoft2-1.0-0 'ldconfig -p | grep libpangoft2' ;; # WeasyPrint's
	povray) want povray 'command -v povray' ;; # of `python -m tools.bench blind`
	poppler-utils) want poppler-utils 'command -v pdftoppm' ;;
	*) echo "need.sh: unknown need '$need'" >&2; exit 2 ;;
	esac
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ]; then sudo=""; elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo="sudo"; else
	echo "annulus: these Debian packages are needed: apt-get install$missing" >&2
	exit 1
fi
echo "installing$missing"
$sudo apt-get update -qq
DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends $missing >/dev/null
