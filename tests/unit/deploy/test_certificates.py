"""Promises of the cluster's certificates: Python's TLS takes them, each for its own role, and nobody else's."""

import re
import ssl
import stat
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "tools/deploy/certificates.sh"
ROLES = ("scheduler", "worker", "client")


def made(folder: Path, *more: str) -> Path:
    subprocess.run([str(SCRIPT), str(folder), *more], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("cluster") / "tls")


def context(purpose: ssl.Purpose, tls: Path, role: str) -> ssl.SSLContext:
    """As dask makes one, and as strict as Python 3.13 is of itself."""
    out = ssl.create_default_context(purpose, cafile=str(tls / "ca.pem"))
    out.check_hostname, out.verify_mode = False, ssl.CERT_REQUIRED
    out.verify_flags |= ssl.VERIFY_X509_STRICT
    out.minimum_version = ssl.TLSVersion.TLSv1_3
    out.load_cert_chain(str(tls / f"{role}.pem"), str(tls / f"{role}.key"))
    return out


def meet(server: ssl.SSLContext, client: ssl.SSLContext) -> None:
    """A handshake in memory. Raises ssl.SSLError where one does not believe the other."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (
        client.wrap_bio(to_client, to_server, server_side=False),
        server.wrap_bio(to_server, to_client, server_side=True),
    )
    done = [False, False]
    for _ in range(10):
        for i, end in enumerate(ends):
            if not done[i]:
                try:
                    end.do_handshake()
                    done[i] = True
                except ssl.SSLWantReadError:
                    pass
    assert all(done)


def test_each_is_believed_in_its_role(tls: Path) -> None:
    for server, client in (("scheduler", "worker"), ("scheduler", "client"), ("worker", "scheduler")):
        meet(context(ssl.Purpose.CLIENT_AUTH, tls, server), context(ssl.Purpose.SERVER_AUTH, tls, client))


def test_a_client_cannot_pose_as_a_scheduler(tls: Path) -> None:
    with pytest.raises(ssl.SSLError, match="purpose"):
        meet(context(ssl.Purpose.CLIENT_AUTH, tls, "client"), context(ssl.Purpose.SERVER_AUTH, tls, "worker"))


def test_another_clusters_keys_open_nothing(tls: Path, tmp_path: Path) -> None:
    other = made(tmp_path / "other")
    mixed = context(ssl.Purpose.SERVER_AUTH, other, "client")
    mixed.load_verify_locations(str(tls / "ca.pem"))
    with pytest.raises(ssl.SSLError):
        meet(context(ssl.Purpose.CLIENT_AUTH, tls, "scheduler"), mixed)


def test_keys_are_their_owners_alone_and_the_authoritys_is_not_kept(tls: Path) -> None:
    names = {path.name for path in tls.iterdir()}
    assert names == {"ca.pem", *(f"{role}.{kind}" for role in ROLES for kind in ("pem", "key"))}
    assert {stat.S_IMODE(path.stat().st_mode) for path in tls.glob("*.key")} == {0o600}
    assert len({path.read_bytes() for path in tls.glob("*.key")}) == 3
    assert stat.S_IMODE(tls.stat().st_mode) == 0o700


def ends(path: Path) -> datetime:
    said = subprocess.run(["openssl", "x509", "-in", str(path), "-noout", "-enddate"], capture_output=True, text=True)
    return datetime.strptime(said.stdout.strip(), "notAfter=%b %d %H:%M:%S %Y GMT").replace(tzinfo=UTC)


def test_they_are_short_lived(tls: Path, tmp_path: Path) -> None:
    three = made(tmp_path / "three", "3")
    for folder, days in ((tls, 30), (three, 3)):
        left = [ends(path) - datetime.now(UTC) for path in folder.glob("*.pem")]
        assert all(timedelta(days=days - 1) < one <= timedelta(days=days) for one in left) and len(left) == 4


@pytest.mark.parametrize(
    ("more", "said"), [(["0"], "number of days"), (["398"], "number of days"), (["x"], "number of days")]
)
def test_what_cannot_be_is_refused_in_one_line(more: list[str], said: str, tmp_path: Path) -> None:
    run = subprocess.run([str(SCRIPT), str(tmp_path / "new"), *more], capture_output=True, text=True)
    assert run.returncode and said in run.stderr and run.stderr.count("\n") == 1 and not (tmp_path / "new").exists()


def test_keys_that_are_there_are_not_written_over(tls: Path) -> None:
    before = {path.name: path.read_bytes() for path in tls.iterdir()}
    run = subprocess.run([str(SCRIPT), str(tls)], capture_output=True, text=True)
    assert run.returncode == 1 and re.search("is there already", run.stderr)
    assert before == {path.name: path.read_bytes() for path in tls.iterdir()}
