"""The manifests of deploy/kubernetes are valid, and agree with the code, the image and each other."""

from __future__ import annotations

import gzip
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml

from giirl.run.fleet import LEAVE_TIMEOUT_S, STOP_TIMEOUT_S, places
from giirl_core.config import Config
from giirl_core.config_file import load_config
from tests.deploy import kustomize
from tests.deploy.make_schemas import SCHEMAS
from tests.end_to_end.commands import ROOT
from tests.test_docs import mistakes

KUBERNETES = ROOT / "deploy/kubernetes"
FOLDERS = ("base", "overlays/interactive", "overlays/job")
OVERLAYS = FOLDERS[1:]
CUSTOM = sorted(path.name.partition(".")[0] for path in SCHEMAS.glob("*.json.gz"))


def manifests(folder: str) -> dict[str, dict[str, Any]]:
    """The manifests by their kind."""
    return {manifest["kind"]: manifest for manifest in kustomize.build(KUBERNETES / folder)}


def strict(schema: Any) -> Any:
    """The schema with unknown fields forbidden, which a cluster would drop without a word."""
    if isinstance(schema, list):
        return [strict(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {key: strict(part) for key, part in schema.items()}
    if isinstance(schema.get("properties"), dict) and not schema.get("x-kubernetes-preserve-unknown-fields"):
        closed.setdefault("additionalProperties", False)
    return closed


def check(manifest: dict[str, Any]) -> None:
    """Raise an error if the manifest is not valid."""
    kind = manifest["kind"]
    if kind not in CUSTOM:
        kubernetes_validate.validate(manifest, kubernetes_validate.latest_version(), strict=True)
        return
    schema = strict(json.loads(gzip.decompress((SCHEMAS / f"{kind}.json.gz").read_bytes())))
    schema["properties"]["metadata"] = {"type": "object"}
    jsonschema.Draft202012Validator(schema).validate(manifest)


def pods() -> Iterator[tuple[str, dict[str, Any]]]:
    """The pod templates of every cluster, with the name of their group."""
    for folder in OVERLAYS:
        spec = cluster(folder)
        for group in (spec["headGroupSpec"], *spec["workerGroupSpecs"]):
            yield f"{folder} {group.get('groupName', 'head')}", group["template"]


def cluster(folder: str) -> dict[str, Any]:
    """The specification of a Ray cluster."""
    found = manifests(folder)
    spec: dict[str, Any] = (
        found["RayJob"]["spec"]["rayClusterSpec"] if "RayJob" in found else found["RayCluster"]["spec"]
    )
    return spec


def job() -> tuple[list[str], Config]:
    """The words of the job's command, and its settings."""
    words = shlex.split(manifests("overlays/job")["RayJob"]["spec"]["entrypoint"])
    path = ROOT / Path(words[2]).relative_to("/opt/giirl")
    return words, load_config(path, [word for word in words[3:] if "=" in word])


def ports(folder: str) -> dict[str, int]:
    """Every port of the pods by its name."""
    spec = cluster(folder)
    groups = (spec["headGroupSpec"], *spec["workerGroupSpecs"])
    containers = [container for group in groups for container in group["template"]["spec"]["containers"]]
    return {port["name"]: port["containerPort"] for container in containers for port in container["ports"]}


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_manifest_is_valid_and_has_no_unknown_field(folder: str) -> None:
    for manifest in kustomize.build(KUBERNETES / folder):
        check(manifest)


@pytest.mark.parametrize("kind", ["RayCluster", "NetworkPolicy", "PodMonitor", "PersistentVolumeClaim"])
def test_a_misspelt_field_is_found(kind: str) -> None:
    manifest = manifests("base")[kind]
    manifest["spec"]["acessModes"] = []
    with pytest.raises((jsonschema.ValidationError, kubernetes_validate.ValidationError)):
        check(manifest)


@pytest.mark.parametrize("folder", FOLDERS)
def test_kustomize_builds_the_same_manifests(folder: str) -> None:
    if not (kubectl := shutil.which("kubectl")):
        pytest.skip("kubectl is not on PATH")
    done = subprocess.run(
        [kubectl, "kustomize", KUBERNETES / folder], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert {m["kind"]: m for m in yaml.safe_load_all(done.stdout)} == manifests(folder)


def test_each_overlay_makes_a_cluster_or_a_job() -> None:
    shared = {"PersistentVolumeClaim", "NetworkPolicy", "PodMonitor", "PrometheusRule"}
    assert set(manifests("overlays/interactive")) == {*shared, "RayCluster"}
    assert set(manifests("overlays/job")) == {*shared, "RayJob"}


def test_the_rules_of_the_operator_are_the_tested_ones() -> None:
    groups = yaml.safe_load((ROOT / "deploy/rules.yml").read_text())["groups"]
    assert manifests("base")["PrometheusRule"]["spec"]["groups"] == groups


def test_the_command_of_the_job_exists_and_retries_go_on_with_the_run() -> None:
    words, config = job()
    assert mistakes(" ".join(words)) == []
    assert config.runtime == "ray"
    assert "--resume-or-start" in words
    assert manifests("overlays/job")["RayJob"]["spec"]["backoffLimit"] > 0
    (claim,) = [
        v for v in cluster("overlays/job")["headGroupSpec"]["template"]["spec"]["volumes"] if v["name"] == "runs"
    ]
    assert claim["persistentVolumeClaim"]["claimName"] == manifests("base")["PersistentVolumeClaim"]["metadata"]["name"]
    (head,) = cluster("overlays/job")["headGroupSpec"]["template"]["spec"]["containers"]
    (mount,) = [m["mountPath"] for m in head["volumeMounts"] if m["name"] == "runs"]
    assert Path(config.run).parent == Path(mount)


def test_the_ports_of_the_metrics_are_those_of_the_job_and_open_to_prometheus() -> None:
    metrics, found = job()[1].metrics, ports("overlays/job")
    workers = [number for name, number in found.items() if name.startswith("worker-")]
    assert metrics.host == "0.0.0.0"
    assert metrics.port == found["learner"]
    assert workers == list(range(metrics.worker_port, metrics.worker_port + len(workers)))
    monitor, policy = manifests("base")["PodMonitor"]["spec"], manifests("base")["NetworkPolicy"]["spec"]
    scraped = {endpoint["port"] for endpoint in monitor["podMetricsEndpoints"]}
    assert scraped == {name for name in found if name == "learner" or name.startswith("worker-")}
    (opened,) = [r["ports"][0] for r in policy["ingress"] if r.get("ports") and "endPort" in r["ports"][0]]
    assert (opened["port"], opened["endPort"]) == (metrics.port, workers[-1])


def test_a_pod_has_a_port_a_core_memory_and_a_chrome_for_each_of_its_actors() -> None:
    place = places(job()[1])["actor"]
    (group,) = cluster("overlays/job")["workerGroupSpecs"]
    (container,) = group["template"]["spec"]["containers"]
    resources = json.loads(json.loads(group["rayStartParams"]["resources"]))
    assert set(resources) == set(place.resources)
    actors = int(resources["chrome"] / place.resources["chrome"])
    assert int(container["resources"]["limits"]["cpu"]) >= actors * place.cpus
    assert int(container["resources"]["limits"]["memory"].removesuffix("Gi")) << 30 >= actors * place.memory_bytes
    assert len(container["ports"]) == actors + 1  # and one for a reward service
    assert group["maxReplicas"] * actors >= job()[1].actors.count


@pytest.mark.parametrize(("name", "template"), list(pods()))
def test_pods_have_shared_memory_no_privileges_and_time_to_end(name: str, template: dict[str, Any]) -> None:
    spec = template["spec"]
    (container,) = spec["containers"]
    (shm,) = [volume for volume in spec["volumes"] if volume["name"] == "shm"]
    assert shm["emptyDir"]["medium"] == "Memory"
    assert int(shm["emptyDir"]["sizeLimit"].removesuffix("Gi")) >= 1
    assert {m["mountPath"] for m in container["volumeMounts"]} >= {"/dev/shm"}
    assert spec["securityContext"]["runAsNonRoot"]
    assert container["securityContext"] == {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}
    needed = STOP_TIMEOUT_S if "actors" in name else LEAVE_TIMEOUT_S + STOP_TIMEOUT_S
    assert spec["terminationGracePeriodSeconds"] > needed
    assert template["metadata"]["labels"]["app.kubernetes.io/name"] == "giirl"


def test_the_head_is_stopped_by_the_signal_that_saves_and_ray_waits_for_it() -> None:
    (head,) = cluster("overlays/interactive")["headGroupSpec"]["template"]["spec"]["containers"]
    command = head["lifecycle"]["preStop"]["exec"]["command"][-1]
    pattern = re.findall(r'-f "([^"]+)"', command)
    assert len(set(pattern)) == 1
    assert re.search(pattern[0], " ".join(job()[0]))
    assert not re.search(pattern[0], command), "it would wait for itself"
    assert "-INT" in command
    waits_s = {v["name"]: v["value"] for v in head["env"]}["RAY_JOB_STOP_WAIT_TIME_S"]
    grace_s = cluster("overlays/interactive")["headGroupSpec"]["template"]["spec"]["terminationGracePeriodSeconds"]
    assert STOP_TIMEOUT_S < float(waits_s) < grace_s


def test_policy_and_monitor_select_the_pods_of_the_cluster() -> None:
    labels = [template["metadata"]["labels"] for _, template in pods()]
    base = manifests("base")
    for selector in (base["NetworkPolicy"]["spec"]["podSelector"], base["PodMonitor"]["spec"]["selector"]):
        assert all(selector["matchLabels"].items() <= found.items() for found in labels)


def test_image_and_ray_have_the_versions_of_the_project() -> None:
    constraints = (ROOT / "constraints.txt").read_text()
    project = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    for folder in OVERLAYS:
        assert f"ray=={cluster(folder)['rayVersion']}\n" in constraints
    images = {container["image"] for _, template in pods() for container in template["spec"]["containers"]}
    assert project
    assert images == {f"localhost/giirl:{project.group(1)}"}


def test_the_token_comes_from_a_secret_and_the_certificates_of_a_job_from_the_operator() -> None:
    for folder in OVERLAYS:
        assert cluster(folder)["authOptions"] == {"mode": "token", "secretName": "giirl-ray-token"}
    assert cluster("overlays/job")["tlsOptions"] == {"enabled": True}
    assert "giirl-ray-token" in (ROOT / "deploy/README.md").read_text()
