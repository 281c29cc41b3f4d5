"""The guest is what the other tests here take it for."""

import socket
import threading
import uuid
from pathlib import Path

import pytest
from machine import HOST, ROOT, Guest, GuestError


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_it_runs_the_checkouts_own_python_on_debians_kernel(guest: Guest) -> None:
    done = guest.python("import annulus_pipe, os; print(annulus_pipe.__file__, os.uname().release)")
    assert done.status == 0, done
    assert done.stdout.split() == [str(ROOT / "host/annulus_pipe/__init__.py"), guest.release]


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_a_script_that_fails_or_takes_too_long_is_told_apart(guest: Guest) -> None:
    failed = guest.python("print(1); import sys; sys.exit('why')")
    assert (failed.status, failed.stdout, failed.stderr) == (1, "1\n", "why\n")
    late = guest.run(["sh", "-c", "echo 2; sleep 600"], seconds=30.0)  # the shell must have begun by then
    assert (late.status, late.stdout) == (None, "2\n")


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_what_it_writes_stays_in_it(guest: Guest) -> None:
    name = Path("/tmp", f"annulus-{uuid.uuid4()}")
    done = guest.python("import sys; open(sys.argv[1], 'w').write('in'); print(open(sys.argv[1]).read())", str(name))
    assert done.stdout == "in\n", done
    assert not name.exists()
    name = ROOT / f"annulus-{uuid.uuid4()}"
    assert "Read-only file system" in guest.run(["touch", str(name)]).stderr
    assert not name.exists()


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_it_reaches_a_server_on_the_host(guest: Guest) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"heard " + connection.recv(100))

        threading.Thread(target=serve, daemon=True).start()
        port = server.getsockname()[1]
        done = guest.python(
            f"""
            import socket
            line = socket.create_connection(("{HOST}", {port}))
            line.sendall(b"you")
            print(line.recv(100))
            """
        )
    assert done.stdout == "b'heard you'\n", done


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_a_driver_that_is_not_there_is_said_with_the_kernels_words(guest: Guest) -> None:
    with pytest.raises(GuestError, match=r"modprobe no_such_driver: .*not found"):
        guest.modprobe("no_such_driver")
