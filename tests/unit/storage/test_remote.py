"""Promises of files in a store: a fault of it is survived with the same bytes, or is one line; nothing half-written."""

import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest

from annulus_pipe.storage import remote
from annulus_pipe.storage.place import StoragePath, where, writer
from annulus_pipe.storage.remote import ChangedError, Patience, RemoteFile, UnreachableError, Url, joined, remote_file
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.object_store import ObjectStore

PATIENT = Patience(attempts=5, answer_s=20.0, wait_s=0.02)  # also where the machine is busy
HASTY = Patience(attempts=9, answer_s=2.0, wait_s=0.02)

CONTENT = bytes(range(256)) * 4000


@pytest.fixture(scope="module")
def running() -> Iterator[ObjectStore]:
    with ObjectStore() as store:
        yield store


@pytest.fixture
def store(running: ObjectStore, monkeypatch: pytest.MonkeyPatch) -> Iterator[ObjectStore]:
    monkeypatch.setattr(remote, "PATIENCE", PATIENT)
    running.slow_s = 3.0
    running.forget()
    yield running
    running.fault = lambda number, asked: None


@pytest.mark.parametrize(
    "text, expected",
    [
        ("s3://a/b/c.mcap", ("c.mcap", "c", ".mcap", "s3://a/b", "s3://a/b/d")),
        ("gs://a/c", ("c", "c", "", "gs://a", "gs://a/d")),
    ],
)
def test_a_url_has_names_as_a_path_has(text: str, expected: tuple[str, ...]) -> None:
    url = where(text)
    assert isinstance(url, Url) and pickle.loads(pickle.dumps(url)) == url
    assert (url.name, url.stem, url.suffix, str(url.parent), str(url.with_name("d"))) == expected


def test_a_path_stays_a_path(tmp_path: Path) -> None:
    assert where(tmp_path) == where(str(tmp_path)) == where(f"file://{tmp_path}") == tmp_path


@pytest.mark.parametrize("text", ["file://host/a", "ftp://a/b", "s3:///b", "simplecache::s3://a/b", "s3://a/b::s3://c"])
def test_what_is_no_place_is_one_line(text: str) -> None:
    if "::" in text and not text.startswith("s3"):
        assert where(text) == Path(text)  # a name, however odd
        return
    with pytest.raises(AnnulusError):
        where(text)


def test_a_password_is_never_shown() -> None:
    url = Url("sftp://me:secret@host:22/a/b")
    assert "secret" not in f"{url} {url!r}" and str(url) == "sftp://me@host:22/a/b"


@pytest.mark.parametrize("local", [True, False])
def test_a_place_keeps_what_is_written(store: ObjectStore, tmp_path: Path, local: bool) -> None:
    place = StoragePath(tmp_path / "out" if local else store.url("out"))
    assert place.read("a") is None and place.names() == [] and place.names("b/") == []
    place.write("b/2", b"two")
    place.write("b/1", b"one")
    place.write("b/1", b"uno")
    place.write("c", b"")
    with writer(place, "b/3") as file:
        file.write(CONTENT)
    assert place.names() == ["b/1", "b/2", "b/3", "c"]
    assert place.names("b/") == ["b/1", "b/2", "b/3"] and place.names("b/2") == ["b/2"]
    assert [place.read(name) for name in ("b/1", "b/2", "b/3", "c")] == [b"uno", b"two", CONTENT, b""]
    place.remove("b/1")
    place.remove("b/1")
    assert place.read("b/1") is None and (place / "b").names() == ["2", "3"]
    again = pickle.loads(pickle.dumps(place))
    assert again.read("b/2") == b"two"


@pytest.mark.parametrize("local", [True, False])
def test_a_writer_that_fails_changes_nothing(store: ObjectStore, tmp_path: Path, local: bool) -> None:
    place = StoragePath(tmp_path if local else store.url("half"))
    place.write("a", b"before")
    with pytest.raises(ZeroDivisionError), writer(place, "a") as file:
        file.write(b"after")
        raise ZeroDivisionError
    assert place.read("a") == b"before" and place.names() == ["a"]


def test_a_folder_goes_into_a_place_its_last_file_after_the_others(
    store: ObjectStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a/summary.json", "summary.json", "wall.npz", "windows/0001/wall.npz"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    written: list[str] = []
    write = StoragePath.write
    monkeypatch.setattr(
        StoragePath, "write", lambda self, name, content: (written.append(name), write(self, name, content))
    )
    place = StoragePath(store.url("folder"))
    place.write_folder(tmp_path, last="summary.json", leave_out="windows")
    assert written == ["wall.npz", "a/summary.json", "summary.json"]
    assert place.names() == sorted(written) and place.read("a/summary.json") == b"a/summary.json"


@pytest.mark.parametrize("name", ["", "/a", "../a", "a/../../b", "a\\b", "a\0"])
def test_a_name_stays_in_its_place(tmp_path: Path, name: str) -> None:
    with pytest.raises(AnnulusError):
        StoragePath(tmp_path / "in").write(name, b"")


@pytest.mark.parametrize("fault", ["500", "503", "slow", "cut", "half"])
def test_a_fault_is_survived_with_the_same_bytes(
    store: ObjectStore, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = Url(store.put("faults/a", CONTENT))
    store.fault = lambda number, asked: fault if number % 2 else None
    if fault == "slow":
        monkeypatch.setattr(remote, "PATIENCE", HASTY)
    assert StoragePath(url.parent).read("a") == CONTENT
    with RemoteFile(url) as file:
        file.seek(1000)
        assert file.read(70_000) == CONTENT[1000:71_000]
    StoragePath(url.parent).write("b", CONTENT)
    store.fault = lambda number, asked: None
    assert store.get("faults/b") == CONTENT and store.faults


def test_a_store_that_fails_for_ever_is_one_line_in_bounded_time(store: ObjectStore) -> None:
    url = Url(store.put("faults/c", CONTENT))
    store.fault = lambda number, asked: "500"
    with pytest.raises(UnreachableError, match="failed 5 times in"):
        StoragePath(url.parent).read("c")
    assert 1 < store.requests <= 5  # an attempt on a connection that the store has just closed asks it nothing


def test_what_is_not_there_is_one_line_at_once(store: ObjectStore) -> None:
    with pytest.raises(FileNotFoundError):
        RemoteFile(Url(store.url("nothing")))
    with pytest.raises(AnnulusError, match="no such bucket"):
        StoragePath("s3://nobodys").write("a", b"")
    assert store.requests <= 6


def test_no_permission_is_one_line_at_once(store: ObjectStore, monkeypatch: pytest.MonkeyPatch) -> None:
    import s3fs

    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nonexistent")
    monkeypatch.setenv("AWS_CONFIG_FILE", "/nonexistent")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(AnnulusError, match="no permission"):
        StoragePath(store.url("x")).read("a")
    s3fs.S3FileSystem.clear_instance_cache()


def test_a_file_that_changes_is_told(store: ObjectStore) -> None:
    url = Url(store.put("changed", CONTENT))
    file = RemoteFile(url)
    assert file.read(10) == CONTENT[:10]
    store.put("changed", CONTENT[::-1])
    with pytest.raises(ChangedError, match="not what it was"):
        file.read(10)
    with pytest.raises(ChangedError):
        RemoteFile(url, file.known).read(1)


def test_neighbours_are_read_in_one_request(store: ObjectStore) -> None:
    url = Url(store.put("plan", CONTENT))
    file = remote_file(url, None)
    store.forget()
    file.plan([(0, 1000), (1010, 2000), (500_000, 500_100)])
    for start, end in ((0, 1000), (1010, 2000), (500_000, 500_100)):
        file.seek(start)
        assert file.read(end - start) == CONTENT[start:end]
    assert store.requests == 2 and store.given == 2100 and remote_file(url, None) is file


def test_what_is_joined_is_bounded() -> None:
    step = 1 << 20
    out = joined((i * step, (i + 1) * step) for i in range(100))
    assert sum(end - start for start, end in out) == 100 * step
    assert max(end - start for start, end in out) <= remote.JOINED_MAX and len(out) == 7
