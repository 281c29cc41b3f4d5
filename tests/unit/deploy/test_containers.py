"""Promises of what runs in containers: nothing but one image, nothing it may not need, and no door but TLS."""

import asyncio
import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from distributed.cli import dask_scheduler, dask_worker
from distributed.comm import listen
from distributed.security import Security

from tools.bench.dask_processes import AS_DEPLOYED

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "tools/deploy"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
GIB = 1 << 30
UNITS = {"g": GIB, "Gi": GIB, "m": 1 << 20, "Mi": 1 << 20}


def composed(name: str) -> dict[str, Any]:
    return yaml.safe_load((DEPLOY / name).read_text(encoding="utf-8"))  # type: ignore[no-any-return]


SERVICES = [(f, name, one) for f in ("compose.yaml", "machine.yaml") for name, one in composed(f)["services"].items()]
MANIFEST = list(yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text(encoding="utf-8")))
PODS = [(one["metadata"]["name"], one["spec"]["template"]) for one in MANIFEST if "template" in one.get("spec", {})]


def usual(text: str) -> str:
    """With nothing set in the environment."""
    return re.sub(r"\$\{\w+(?::-([^}]*)|:\?[^}]*)?\}", lambda found: found[1] or "", text)


def size(text: str) -> int:
    number, unit = re.fullmatch(r"(\d+)(\w+)", text).groups()  # type: ignore[union-attr]
    return int(number) * UNITS[unit]


@pytest.mark.parametrize(("file", "name", "service"), SERVICES, ids=lambda one: one if isinstance(one, str) else "")
def test_a_service_may_nothing_that_it_does_not_need(file: str, name: str, service: dict[str, Any]) -> None:
    assert usual(service["image"]) == f"annulus:{PROJECT['version']}"
    user, group = usual(service["user"]).split(":")
    assert int(user) >= 1000 <= int(group)
    assert service["read_only"] is True and service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert not service.keys() & {"privileged", "cap_add", "devices", "pid", "ipc"}
    limits = service["deploy"]["resources"]["limits"]
    assert size(limits["memory"]) <= 2 * GIB and limits["cpus"] == "1" and limits["pids"] <= 200
    written = [one for one in service["volumes"] if not usual(one).endswith(":ro")]
    assert [usual(one).rpartition(":")[2] for one in written] in (["/scratch"], ["/scratch", "/season"])
    role = next(word for word in service["secrets"] if word.endswith(".key"))
    assert role == f"{name}.key" and service["secrets"] == ["ca.pem", f"{name}.pem", role]
    assert all(one in composed(file)["secrets"] for one in service["secrets"])


def test_no_port_is_open_but_the_schedulers_on_loopback() -> None:
    ports = {(name, usual(port)) for _, name, one in SERVICES for port in one.get("ports", [])}
    assert ports == {("scheduler", "127.0.0.1:8786:8786")}
    hosted = [one for *_, one in SERVICES if one.get("network_mode")]  # there, dask itself opens: where it is told to
    assert [one for word in hosted for one in word["command"] if one.startswith("--host=${ANNULUS_ADDRESS:?")]
    assert len(hosted) == 1


@pytest.mark.parametrize(("name", "template"), PODS)
def test_a_pod_may_nothing_that_it_does_not_need(name: str, template: dict[str, Any]) -> None:
    """Pod Security Standards, restricted, and a root that cannot be written."""
    spec = template["spec"]
    assert spec["securityContext"]["runAsNonRoot"] is True and spec["securityContext"]["runAsUser"] == 10001
    assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert spec["automountServiceAccountToken"] is False
    assert not spec.keys() & {"hostNetwork", "hostPID", "hostIPC"}
    (container,) = spec["containers"]
    assert container["image"].endswith(f"/annulus:{PROJECT['version']}")
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    limits = container["resources"]["limits"]
    assert limits["cpu"] == "1" and size(limits["memory"]) <= 2 * GIB and "ephemeral-storage" in limits
    assert container["resources"]["requests"].keys() == limits.keys()
    mounted = {one["name"]: one["mountPath"] for one in container["volumeMounts"]}
    volumes = {one["name"]: one for one in spec["volumes"]}
    assert mounted == {"scratch": "/scratch", "tls": "/tls"} and volumes.keys() == mounted.keys()
    role = template["metadata"]["labels"]["role"]
    assert volumes["tls"]["secret"] == {"secretName": f"tls-{role}", "defaultMode": 0o440}
    assert size(volumes["scratch"]["emptyDir"]["sizeLimit"]) == size(limits["ephemeral-storage"])


def test_only_these_pods_speak() -> None:
    kinds = [one["kind"] for one in MANIFEST]
    assert sorted(kinds) == sorted(
        ["Namespace", "ServiceAccount", "NetworkPolicy", "NetworkPolicy", "Service", "Deployment", "Deployment", "Job"]
    )
    assert all(one["metadata"].get("namespace") == "annulus" for one in MANIFEST if one["kind"] != "Namespace")
    nobody, some = (one["spec"] for one in MANIFEST if one["kind"] == "NetworkPolicy")
    assert nobody == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    ours = [{"podSelector": {"matchLabels": {"app": "annulus"}}}]
    assert [one["from"] for one in some["ingress"]] == [ours]
    assert [port["port"] for port in some["ingress"][0]["ports"]] == [8786, 9000]
    assert [port["port"] for one in some["egress"] if "to" not in one for port in one["ports"]] == [443]
    (service,) = (one["spec"] for one in MANIFEST if one["kind"] == "Service")
    assert service["type"] == "ClusterIP"
    labels = dict(PODS)["scheduler"]["metadata"]["labels"]
    assert service["selector"].items() <= labels.items()
    assert all(template["metadata"]["labels"]["app"] == "annulus" for _, template in PODS)


COMMANDS = [(name, one["command"]) for _, name, one in SERVICES if "command" in one] + [
    (name, template["spec"]["containers"][0]["args"]) for name, template in PODS if name != "reprocess"
]


@pytest.mark.parametrize(("name", "words"), COMMANDS, ids=[f"{i}-{name}" for i, (name, _) in enumerate(COMMANDS)])
def test_dask_takes_what_it_is_given_and_speaks_tls(name: str, words: list[str]) -> None:
    assert words[:2] == ["dask", name]
    command = {"scheduler": dask_scheduler, "worker": dask_worker}[name].main
    there = [re.sub(r"=/(run/secrets|tls)/.*", f"={__file__}", usual(word)) for word in words[2:]]
    told = command.make_context(f"dask {name}", there).params
    assert told["dashboard_address"].startswith("127.0.0.1:")
    given = [word for word in words if word.startswith("--tls")]
    assert [word.partition("=")[0] for word in given] == ["--tls-ca-file", "--tls-cert", "--tls-key"]
    if name == "worker":
        assert told["nthreads"] == 1 and told["nanny"] is False and told["memory_limit"] == "0"
        assert told["scheduler"].startswith("tls://")
    else:
        assert told["protocol"] == "tls"


async def listening(address: str) -> None:
    """As a scheduler would with what the image sets in its environment, and no certificates."""
    security = Security(require_encryption=True)
    await listen(address, lambda comm: None, **security.get_listen_args("scheduler")).start()


@pytest.mark.parametrize("address", ["tcp://0.0.0.0:0", "tcp://127.0.0.1:0"])
def test_with_what_the_image_sets_dask_opens_nothing_without_tls(address: str) -> None:
    with pytest.raises(RuntimeError, match="encryption required"):
        asyncio.run(listening(address))


def steps() -> list[tuple[str, str]]:
    text = (DEPLOY / "Dockerfile").read_text(encoding="utf-8")
    text = re.sub(r"^#.*\n", "", text, flags=re.M).replace("\\\n", " ")
    return [(line.split()[0], line.partition(" ")[2]) for line in text.splitlines() if line.strip()]


def test_the_image_is_built_from_what_is_locked() -> None:
    said = {word: [rest for first, rest in steps() if first == word] for word in ("FROM", "RUN", "USER", "ENV")}
    assert all(rest.startswith("${BASE}") for rest in said["FROM"]) and len(said["FROM"]) == 2
    runs = " ; ".join(said["RUN"])
    assert runs.count("apt-get install -y --no-install-recommends") == runs.count("apt-get install") == 2
    assert "pip install --no-cache-dir --quiet --require-hashes" in runs and "uv sync --frozen --no-dev" in runs
    extras = re.findall(r"--extra (\w+)", runs)
    assert set(extras) <= PROJECT["optional-dependencies"].keys() and {"cluster", "archive", "pdf"} <= set(extras)
    assert "gcc" not in said["RUN"][-1] and "make" not in said["RUN"][-1].split()  # no compiler stays behind
    assert said["USER"] == ["10001:10001"]
    variables = dict(word.split("=", 1) for word in shlex.split(said["ENV"][-1]))
    assert all(variables[f"{one}_NUM_THREADS"] == "1" for one in ("OMP", "OPENBLAS", "MKL"))
    assert variables["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] == "True"
    assert all(variables[one].startswith("/scratch") for one in ("HOME", "TMPDIR"))
    labels = " ".join(rest for first, rest in steps() if first == "LABEL")
    assert f'version="{PROJECT["version"]}"' in labels and 'revision="${COMMIT}"' in labels


def test_debians_python_is_one_that_is_taken() -> None:
    assert ("ARG", "BASE=debian:12-slim") in steps()
    assert PROJECT["requires-python"] == ">=3.11"  # Debian 12's


def test_what_builds_the_image_is_what_is_locked() -> None:
    lock = {
        one["name"]: one
        for one in tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]
        if "wheels" in one
    }
    pinned = {}
    for line in (DEPLOY / "build.txt").read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            name, version = line.split()[0].split("==")
            pinned[name] = (version, sorted(re.findall(r"--hash=(\S+)", line)))
    uv, _ = pinned.pop("uv")
    assert f"UV_VERSION := {uv}\n" in (ROOT / "Makefile").read_text(encoding="utf-8")
    needed, todo = set(), ["hatchling"]
    while todo:
        needed.add(name := todo.pop())
        todo += [one["name"] for one in lock[name].get("dependencies", []) if one["name"] not in needed]
    assert pinned == {n: (lock[n]["version"], sorted(w["hash"] for w in lock[n]["wheels"])) for n in needed}


def test_no_key_and_nothing_built_goes_into_the_image() -> None:
    kept = (DEPLOY / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert kept[1] == "*" and {"**/*.key", "**/*.pem", "**/__pycache__", "host/annulus_pipe/shipped/*.so"} <= set(kept)
    copied = [word for first, rest in steps() if first == "COPY" and "--from" not in rest for word in rest.split()[:-1]]
    assert all(list(ROOT.glob(word)) for word in copied), copied


def test_scripts_can_be_read_by_any_shell() -> None:
    for name in ("begin", "certificates.sh", "processor-x86_64", "processor-aarch64"):
        subprocess.run(["sh", "-n", str(DEPLOY / name)], check=True)


def test_a_machines_file_makes_one_arithmetic() -> None:
    for machine in ("x86_64", "aarch64"):
        said = (DEPLOY / f"processor-{machine}").read_text(encoding="utf-8")
        assert "OPENBLAS_CORETYPE=" in said


def test_what_is_measured_of_a_cluster_is_begun_as_the_image_begins_it() -> None:
    said = (DEPLOY / "Dockerfile").read_text(encoding="utf-8").split()
    assert not [f"{name}={value}" for name, value in AS_DEPLOYED.items() if f"{name}={value}" not in said]
