"""An object store on loopback that counts what it is asked, and fails as it is told: moto behind a small proxy.

    with ObjectStore() as store:                  # bucket "scans" is there, and the environment names the store
        store.put("a/scan.mcap", path)
        store.forget()
        ..                                        # s3://scans/a/scan.mcap
        store.requests, store.given
        store.fault = lambda number, asked: "cut" if number % 3 == 0 else None

Faults: "500", "503", "403" (nothing is done), "slow" (`slow_s` before the answer), "cut" (the line is cut in the
middle of an answer), "half" (half of the answer, which says that it is whole), "flipped" (one bit is another).
"""

import contextlib
import http.client
import os
import socket
import threading
import time
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any

BUCKET = "scans"
_NAMED = {
    "AWS_ACCESS_KEY_ID": "testing",
    "AWS_SECRET_ACCESS_KEY": "testing",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}
_CODES = {"500": "InternalError", "503": "SlowDown", "403": "AccessDenied"}
_HOP = {"connection", "keep-alive", "transfer-encoding", "content-length", "date", "server"}


@dataclass(frozen=True, slots=True)
class Asked:
    """One request, and how many bytes of content were given for it."""

    method: str
    path: str
    status: int
    bytes: int
    fault: str | None = None


class ObjectStore:
    """Runs while the block does. What the environment said of another store is put back."""

    def __init__(self) -> None:
        from moto.server import ThreadedMotoServer  # 1 s

        self.asked: list[Asked] = []
        self.fault: Callable[[int, Asked], str | None] = lambda number, asked: None
        self.faults = 0  # that were made
        self.slow_s = 2.0
        self.delay_s = 0.0  # of every answer, as of a store that is far
        self._behind = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        self._lock = threading.Lock()
        self._number = self._since = 0  # requests that came; before the first that is counted
        self._before: dict[str, str | None] = {}

    @property
    def requests(self) -> int:
        return len(self.asked)

    @property
    def given(self) -> int:
        """That were given by GET."""
        return sum(one.bytes for one in self.asked if one.method == "GET")

    def forget(self) -> None:
        """Count anew; what is still under way is not counted."""
        with self._lock:
            self.asked.clear()
            self.faults = 0
            self._since = self._number

    def url(self, key: str, bucket: str = BUCKET) -> str:
        return f"s3://{bucket}/{key}"

    def put(self, key: str, content: "Path | bytes") -> str:
        """Past the proxy: not counted. Its URL."""
        data = content if isinstance(content, bytes) else content.read_bytes()
        self._direct("PUT", f"/{BUCKET}/{key}", data)
        return self.url(key)

    def get(self, key: str) -> bytes:
        return self._direct("GET", f"/{BUCKET}/{key}")

    def delete(self, key: str) -> None:
        self._direct("DELETE", f"/{BUCKET}/{key}")

    def _direct(self, method: str, path: str, data: bytes | None = None) -> bytes:
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}{path}", data=data, method=method)
        request.add_header("Authorization", "AWS4-HMAC-SHA256 Credential=testing/20260101/us-east-1/s3/aws4_request")
        request.add_header("Content-Type", "application/octet-stream")  # not a form's, which is none of the object
        with urllib.request.urlopen(request, timeout=60) as answer:
            content: bytes = answer.read()
        return content

    def __enter__(self) -> "ObjectStore":
        self._behind.start()
        self._port = self._behind.get_host_and_port()[1]
        self._direct("PUT", f"/{BUCKET}")
        self._proxy = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._proxy.daemon_threads = True
        threading.Thread(target=self._proxy.serve_forever, args=(0.05,), daemon=True).start()
        named = {**_NAMED, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self._proxy.server_address[1]}"}
        self._before = {name: os.environ.get(name) for name in named}
        os.environ.update(named)
        _forget_stores()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        _forget_stores()
        self._proxy.shutdown()
        self._proxy.server_close()
        self._behind.stop()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        store = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: Any) -> None:
                pass

            def _pass_on(self) -> None:
                length = int(self.headers.get("Content-Length") or 0)
                body = self.rfile.read(length) if length else None
                if self.headers.get("Transfer-Encoding", "").lower() == "chunked":
                    body = self._chunks()
                asked = Asked(self.command, self.path, 0, 0)
                with store._lock:
                    number, store._number = store._number, store._number + 1
                    fault = store.fault(number, asked)
                    store.faults += fault is not None
                time.sleep(store.delay_s + (store.slow_s if fault == "slow" else 0.0))
                if fault in _CODES:
                    code = _CODES[fault]
                    self._answer(int(fault), [], f"<Error><Code>{code}</Code><Message>busy</Message></Error>".encode())
                    store._count(number, Asked(self.command, self.path, int(fault), 0, fault))
                    return
                line = http.client.HTTPConnection("127.0.0.1", store._port, timeout=60)
                try:
                    headers = {k: v for k, v in self.headers.items() if k.lower() != "transfer-encoding"}
                    with contextlib.suppress(OSError):  # a body that is not wanted may be answered before it is taken
                        line.request(self.command, self.path, body, headers)
                    got = line.getresponse()
                    data = got.read()
                finally:
                    line.close()
                kept = [(k, v) for k, v in got.getheaders() if k.lower() not in _HOP]
                if self.command == "HEAD":
                    kept.append(("Content-Length", got.getheader("Content-Length") or "0"))
                sent = len(data)
                if data and fault == "half":
                    data = data[: sent // 2]
                if data and fault == "flipped":
                    data = data[: sent // 2] + bytes([data[sent // 2] ^ 1]) + data[sent // 2 + 1 :]
                store._count(number, Asked(self.command, self.path, got.status, len(data), fault))
                self._answer(got.status, kept, data, cut=fault == "cut")

            def _chunks(self) -> bytes:
                out = b""
                while size := int(self.rfile.readline().split(b";")[0], 16):
                    out += self.rfile.read(size)
                    self.rfile.readline()
                while self.rfile.readline().strip():
                    pass
                return out

            def _answer(self, status: int, headers: list[tuple[str, str]], data: bytes, cut: bool = False) -> None:
                try:
                    self.send_response_only(status)
                    for key, value in headers:
                        self.send_header(key, value)
                    if self.command != "HEAD":
                        self.send_header("Content-Length", str(len(data)))
                    self.end_headers()
                    if cut:
                        self.wfile.write(data[: len(data) // 2])
                        self.wfile.flush()
                        self.close_connection = True
                        self.connection.shutdown(socket.SHUT_RDWR)
                    elif self.command != "HEAD":
                        self.wfile.write(data)
                except OSError:
                    self.close_connection = True  # who asked went away

            do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = _pass_on

        return Handler

    def _count(self, number: int, asked: Asked) -> None:
        with self._lock:
            if number >= self._since:
                self.asked.append(asked)


def _forget_stores() -> None:
    """fsspec keeps a client for ever, and that one its address."""
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
