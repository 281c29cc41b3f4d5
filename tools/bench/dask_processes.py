"""A dask scheduler and workers as programs on loopback, as those of tools/deploy are begun."""

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

AS_DEPLOYED = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")} | {
    "MALLOC_ARENA_MAX": "2",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
}  # as tools/deploy/Dockerfile has them
BEGIN_S = 120.0  # for a scheduler to listen, on a machine that is busy


@dataclass
class Cluster:
    """with Cluster() as cluster: cluster.hire(2); ... cluster.url"""

    tls: Sequence[str] = ()  # options of TLS for both programs
    port: int = 0
    scheduler: "subprocess.Popen[bytes] | None" = None
    workers: "list[subprocess.Popen[bytes]]" = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)

    @property
    def url(self) -> str:
        return f"{'tls' if self.tls else 'tcp'}://127.0.0.1:{self.port}"

    def __enter__(self) -> "Cluster":
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.begin()
        return self

    def __exit__(self, *_: object) -> None:
        for process in [*self.workers, *([self.scheduler] if self.scheduler else [])]:
            process.kill()
            process.wait()

    def begin(self) -> None:
        """A scheduler where the last one was."""
        where = ("--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard", "--no-show")
        where = (*where, "--protocol", "tls" if self.tls else "tcp")
        self.scheduler = self._program("scheduler", *where)
        until = time.monotonic() + BEGIN_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            except OSError:
                if self.scheduler.poll() is not None or time.monotonic() > until:
                    raise
                time.sleep(0.1)

    def end(self) -> None:
        """The scheduler killed."""
        assert self.scheduler is not None
        self.scheduler.kill()
        self.scheduler.wait()

    def hire(self, workers: int) -> None:
        """Workers without a nanny: one that dies stays dead."""
        for _ in range(workers):
            where = ("--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard", "--no-nanny", "--death-timeout", "60")
            self.workers.append(self._program("worker", self.url, *where))

    def kill(self, number: int) -> None:
        self.workers[number].send_signal(signal.SIGKILL)
        self.workers[number].wait()

    def processor_s(self, process: "subprocess.Popen[bytes]") -> float:
        """Used so far, user and system."""
        with open(f"/proc/{process.pid}/stat", encoding="ascii") as file:
            fields = file.read().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _program(self, kind: str, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments, *self.tls]
        environment = {**os.environ, **AS_DEPLOYED, **self.environment}
        quiet = subprocess.DEVNULL
        return subprocess.Popen(command, env=environment, stdout=quiet, stderr=quiet, preexec_fn=_with_parent)


def _with_parent() -> None:
    """Never outlive the program that began it."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
