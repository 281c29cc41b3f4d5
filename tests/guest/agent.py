"""Runs in the guest, started by its init: runs what the host asks for, says what came of it.

A line of JSON each way over a virtio port. The host says {"id", "command", "seconds"}; the answer is
{"id", "status", "stdout", "stderr"}, status None when the time was up. Several may run at once. When the host goes away
the port reads as ended, and the machine is switched off.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading

KEPT = 1_000_000  # characters of an output that go back, from its end


def run(asked: dict) -> dict:
    with tempfile.TemporaryFile("w+", errors="replace") as out, tempfile.TemporaryFile("w+", errors="replace") as err:
        try:
            process = subprocess.Popen(
                asked["command"], stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
            )
        except OSError as error:
            return {"id": asked["id"], "status": 127, "stdout": "", "stderr": str(error)}
        try:
            status = process.wait(asked["seconds"])
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            status = None
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read()[-KEPT:])
    return {"id": asked["id"], "status": status, "stdout": texts[0], "stderr": texts[1]}


def main() -> None:
    with open("/dev/vport0p1", "r+b", buffering=0) as port:
        lock = threading.Lock()

        def answer(what: dict) -> None:
            line = json.dumps(what).encode() + b"\n"
            with lock:
                while line:
                    line = line[port.write(line) :]

        answer({"id": 0, "status": 0, "stdout": f"{os.uname().release}", "stderr": ""})
        unread = b""
        while True:
            new = port.read(65536)
            if not new:
                break
            *lines, unread = (unread + new).split(b"\n")
            for line in lines:
                asked = json.loads(line)
                threading.Thread(target=lambda asked=asked: answer(run(asked)), daemon=True).start()


try:
    main()
finally:
    sys.stdout.flush()
    subprocess.run(["/run/busybox", "poweroff", "-f"])
