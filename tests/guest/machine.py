"""A machine with Debian's own kernel, for tests that need real drivers: QEMU, no disk, the host's files read-only.

    with Guest() as guest:
        guest.modprobe("vivid", "n_devs=1")
        done = guest.python("import annulus_pipe; print(annulus_pipe.__file__)", seconds=20)
        assert done.status == 0, done

The guest's root is the host's, over 9p and read-only: the same .venv, the same checkout at the same path. /tmp, /run
and /dev/shm are its own memory, and nothing done in the guest reaches the host. The host's localhost is 10.0.2.2 there.
Where /dev/kvm may be used it is; elsewhere QEMU translates every instruction (TCG), and any machine will do; the
guest is then some ten times slower than the host.
"""

import gzip
import json
import os
import shlex
import shutil
import socket
import stat
import subprocess
import tempfile
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".venv/bin/python"
COMPILED = ROOT / ".venv/.guest"  # bytecode: compiling what a daemon imports takes the guest a minute
IMPORTED = "smbus2, annulus_pipe.record.recording" + "".join(
    f", annulus_pipe.daemon.{name}" for name in ("run", "recorder", "control")
)
HOST = "10.0.2.2"  # as the guest sees it
BOOT_S = 200.0  # 9 s on an idle machine
SLACK_S = 30.0  # for an answer to come back after its command's time was up
KVM = ("-accel", "kvm", "-cpu", "host")
KVM_S = 2.0  # by then a QEMU that cannot use it has ended: 0.1 s on an idle machine
TCG = ("-accel", "tcg,thread=multi", "-cpu", "max")
NEEDED = ("vhci-hcd", "cdc-acm", "vivid", "i2c-stub", "9p")  # what the cloud kernel has not
FIRST = ("virtio_pci", "virtio_console", "virtio_net", "9pnet_virtio", "9p")  # to reach the host at all

INIT = """\
#!/busybox sh
/busybox mkdir -p /proc /sys /dev /host
/busybox mount -t devtmpfs dev /dev
for module in $(/busybox cat /modules/order); do /busybox insmod /modules/$module; done
/busybox mount -t 9p -o ro,trans=virtio,version=9p2000.L,cache=loose,msize=524288 host /host || /busybox poweroff -f
/busybox mount -t proc proc /host/proc
/busybox mount -t sysfs sys /host/sys
/busybox mount -t tmpfs -o mode=755 run /host/run
/busybox cp /busybox /host/run/busybox
/busybox mkdir /host/run/checkout
/busybox mount -o bind /host{root} /host/run/checkout
/busybox mount -t tmpfs -o mode=1777 tmp /host/tmp
if [ ! -d /host{root}/tests ]; then
    /busybox mkdir -p /host{root}
    /busybox mount -o bind /host/run/checkout /host{root}
fi
/busybox mount --move /dev /host/dev
/busybox mkdir -p /host/dev/shm /host/dev/pts
/busybox mount -t tmpfs -o mode=1777 shm /host/dev/shm
/busybox mount -t devpts pts /host/dev/pts
/busybox ip link set lo up
/busybox ip addr add 10.0.2.15/24 dev eth0
/busybox ip link set eth0 up
/busybox ip route add default via 10.0.2.2
export PYTHONPYCACHEPREFIX={compiled} HOME=/tmp LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin
exec /busybox chroot /host {python} -S {agent}
"""


class GuestError(AssertionError):
    """The guest does not do what a guest must. The text ends with what its kernel said last."""


@dataclass(frozen=True, slots=True)
class Done:
    """A command in the guest that came to its end; status None: its time was up, and it was killed."""

    status: int | None
    stdout: str
    stderr: str


def kernel() -> str:
    """The newest kernel on this host that has the drivers. Raises GuestError saying what to install."""
    having = []
    for image in Path("/boot").glob("vmlinuz-*-amd64"):
        release = image.name.removeprefix("vmlinuz-")
        listed = _listed(release)
        if listed and all(name.replace("-", "_") in listed for name in NEEDED):
            having.append(release)
    if not having:
        raise GuestError(
            f"no kernel in /boot has all of {', '.join(NEEDED)}: apt-get install linux-image-amd64 (the cloud kernel,"
            " linux-image-cloud-amd64, has them not; it may stay the one that boots)"
        )
    return max(having, key=lambda release: [int(part) if part.isdigit() else 0 for part in _parts(release)])


class Guest:
    """One machine, on from construction to `close`."""

    def __init__(self) -> None:
        release = kernel()
        self._folder = Path(tempfile.mkdtemp(prefix="annulus-guest-"))
        self._ids = 0
        self._answers: dict[int, Done] = {}
        self._unread = b""
        subprocess.run(
            [str(PYTHON), "-c", f"import {IMPORTED}"],
            env={**os.environ, "PYTHONPYCACHEPREFIX": str(COMPILED), "PYTHONDONTWRITEBYTECODE": ""},
            check=True,
        )
        (self._folder / "initramfs").write_bytes(_initramfs(release))
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._qemu = subprocess.Popen(
                _command(release, self._folder, theirs.fileno()),
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=(self._folder / "qemu").open("wb"),
            )
        began = time.monotonic()
        try:
            self.release = self._answer(0, BOOT_S).stdout
        except BaseException:
            self.close()
            raise
        self.boot_s = time.monotonic() - began

    def __enter__(self) -> "Guest":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()  # the agent reads the end, and switches off
        try:
            self._qemu.wait(2.0)
        except subprocess.TimeoutExpired:
            self._qemu.kill()
            self._qemu.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def log(self) -> str:
        """What the guest's kernel, and QEMU, have said."""
        return "".join(
            (self._folder / name).read_text(errors="replace") for name in ("qemu", "console") if self._is_there(name)
        )

    def start(self, command: list[str], *, seconds: float) -> int:
        """Begin a command in the guest. `wait` takes what this returns."""
        self._ids += 1
        asked = {"id": self._ids, "command": command, "seconds": seconds}
        self._socket.settimeout(SLACK_S)
        self._socket.sendall(json.dumps(asked).encode() + b"\n")
        return self._ids

    def wait(self, id: int, seconds: float) -> Done:
        """What came of a command. Raises GuestError when the guest does not answer `seconds` and a little more."""
        return self._answer(id, seconds + SLACK_S)

    def run(self, command: list[str], *, seconds: float = 30.0) -> Done:
        return self.wait(self.start(command, seconds=seconds), seconds)

    def python(self, script: str, *arguments: str, seconds: float = 60.0) -> Done:
        """A script run by the checkout's own Python: annulus is there."""
        return self.run([str(PYTHON), "-c", textwrap.dedent(script), *arguments], seconds=seconds)

    def modprobe(self, module: str, *parameters: str) -> None:
        """Load a driver. Raises GuestError when the kernel will not."""
        done = self.run(["modprobe", module, *parameters])
        if done.status != 0:
            raise GuestError(f"modprobe {module}: {done.stderr.strip()}{self._last_words()}")

    def _answer(self, id: int, patience_s: float) -> Done:
        end = time.monotonic() + patience_s
        while id not in self._answers:
            left = end - time.monotonic()
            if left <= 0:
                raise GuestError(f"no answer within {patience_s:g} s{self._last_words()}")
            self._socket.settimeout(left)
            try:
                new = self._socket.recv(65536)
            except TimeoutError:
                continue
            except OSError:
                new = b""
            if not new:
                raise GuestError(f"the guest went away{self._last_words()}")
            *lines, self._unread = (self._unread + new).split(b"\n")
            for line in lines:
                told = json.loads(line)
                self._answers[told["id"]] = Done(told["status"], told["stdout"], told["stderr"])
        return self._answers.pop(id)

    def _last_words(self) -> str:
        return "; its log ends:\n" + "\n".join(self.log.splitlines()[-40:])

    def _is_there(self, name: str) -> bool:
        return (self._folder / name).is_file()


def _command(release: str, folder: Path, port: int) -> list[str]:
    return [
        "qemu-system-x86_64",
        "-nodefaults",
        "-no-user-config",
        "-display",
        "none",
        "-no-reboot",
        *(KVM if has_kvm() else TCG),
        "-smp",
        "2",
        "-m",
        "1536",
        "-kernel",
        f"/boot/vmlinuz-{release}",
        "-initrd",
        str(folder / "initramfs"),
        "-append",
        "console=ttyS0 rdinit=/init panic=-1 mitigations=off no_timer_check random.trust_cpu=on loglevel=6",
        "-serial",
        f"file:{folder / 'console'}",
        "-device",
        "virtio-serial-pci",
        "-chardev",
        f"socket,id=agent,fd={port}",
        "-device",
        "virtserialport,chardev=agent,name=annulus",
        "-netdev",
        "user,id=net",
        "-device",
        "virtio-net-pci,netdev=net,romfile=",
        "-virtfs",
        "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
    ]


def has_kvm() -> bool:
    """Whether QEMU runs on this machine's own processor. A nested one may offer it and end QEMU all the same."""
    if not os.access("/dev/kvm", os.R_OK | os.W_OK):
        return False
    paused = ["qemu-system-x86_64", "-nodefaults", "-display", "none", *KVM, "-m", "64", "-S"]
    try:
        subprocess.run(paused, stdin=subprocess.DEVNULL, capture_output=True, timeout=KVM_S, check=False)
    except subprocess.TimeoutExpired:  # it stands there, as it was asked to
        return True
    return False


def _listed(release: str) -> dict[str, list[str]]:
    """Module name to its file and the files it needs, these in the order of modules.dep: deepest last."""
    try:
        lines = Path(f"/lib/modules/{release}/modules.dep").read_text().splitlines()
    except OSError:
        return {}
    listed = {}
    for line in lines:
        file, _, needs = line.partition(":")
        listed[Path(file).name.partition(".")[0].replace("-", "_")] = [file, *needs.split()]
    return listed


def _parts(release: str) -> list[str]:
    return release.replace("-", ".").split(".")


def _initramfs(release: str) -> bytes:
    """busybox, the modules without which the host cannot be reached, and init, as the kernel unpacks them."""
    listed, order = _listed(release), list[str]()
    for module in FIRST:
        order += [file for file in reversed(listed.get(module, [])) if file not in order]
    busybox = shutil.which("busybox")
    if busybox is None:
        raise GuestError("busybox is missing: apt-get install busybox-static")
    python, agent = shlex.quote(os.path.realpath(PYTHON)), shlex.quote(str(Path(__file__).with_name("agent.py")))
    files: dict[str, tuple[int, bytes]] = {
        "busybox": (0o755, Path(busybox).read_bytes()),
        "init": (
            0o755,
            INIT.format(
                python=python, agent=agent, compiled=shlex.quote(str(COMPILED)), root=shlex.quote(str(ROOT))
            ).encode(),
        ),
        "modules": (stat.S_IFDIR | 0o755, b""),
        "modules/order": (0o644, "\n".join(Path(file).name for file in order).encode()),
    }
    for file in order:
        files[f"modules/{Path(file).name}"] = (0o644, Path(f"/lib/modules/{release}", file).read_bytes())
    return gzip.compress(_cpio(files), 1)


def _cpio(files: dict[str, tuple[int, bytes]]) -> bytes:
    """The "newc" archive: a header of eight-digit hexadecimal numbers, name and content, each padded to four bytes."""
    archive = bytearray()
    for number, (name, (mode, content)) in enumerate([*files.items(), ("TRAILER!!!", (0, b""))], 1):
        kind = mode if stat.S_IFMT(mode) else stat.S_IFREG | mode
        numbers = (number, kind, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(name) + 1, 0)
        for part in (b"070701" + b"".join(b"%08X" % n for n in numbers) + name.encode() + b"\0", content):
            archive += part
            archive += bytes(-len(archive) % 4)
    return bytes(archive)
