"""Manifests are what a current Kubernetes takes, and give each service what compose gives it."""

from __future__ import annotations

import math
import re
from typing import Any

import kubernetes_validate
import pytest
import yaml
from athrl.services import CHECKPOINT_SECONDS, DRAIN_SECONDS
from athrl.stopping import STOP_SECONDS
from athrl_protocol.run_file import read_run_file

from tests.kubernetes import custom_resources
from tests.kubernetes.manifests import COMPONENT, OVERLAYS, ROOT, Overlay

VERSION = "1.37"
GIBIBYTES = {"Ki": 1 / 1024**2, "Mi": 1 / 1024, "Gi": 1.0}
SERVICES = ("learner", "actor", "evaluator", "viewer", "tensorboard")

STOPPING = {"learner": CHECKPOINT_SECONDS, "actor": DRAIN_SECONDS, "evaluator": DRAIN_SECONDS,
            "viewer": STOP_SECONDS, "router": STOP_SECONDS}  # fmt: skip
"""Within which a service that is asked to end has ended."""

every_overlay = pytest.mark.parametrize("overlay", OVERLAYS, indirect=True)


@every_overlay
def test_manifests_fit_the_schemas_of_kubernetes(overlay: Overlay) -> None:
    assert {"small", "gpu", "spot", "keda", "cert-manager"} <= set(OVERLAYS)
    for each in overlay.objects:
        if custom_resources.is_custom(each):
            custom_resources.validate(each)
        else:
            kubernetes_validate.validate(each, VERSION, strict=True)


@every_overlay
def test_pods_may_do_nothing_that_they_need_not(overlay: Overlay) -> None:
    labels = overlay.get("Namespace", "athrl")["metadata"]["labels"]
    assert labels["pod-security.kubernetes.io/enforce"] == "restricted"
    for name, pod in overlay.pods().items():
        rights = pod.spec["securityContext"]
        assert (rights["runAsNonRoot"], rights["runAsUser"]) == (True, 10001), name
        assert rights["seccompProfile"] == {"type": "RuntimeDefault"}, name
        assert pod.spec.get("automountServiceAccountToken", True) == (name == "certificates"), name
        for container in pod.containers:
            assert container["securityContext"] == {
                "readOnlyRootFilesystem": True,
                "allowPrivilegeEscalation": False,
                "capabilities": {"drop": ["ALL"]},
            }, name
            assert "memory" in container["resources"]["limits"], name
            assert {"cpu", "memory"} <= set(container["resources"]["requests"]), name


@every_overlay
def test_everything_that_a_pod_names_is_there(overlay: Overlay) -> None:
    for name, pod in overlay.pods().items():
        claims = {each["metadata"]["name"] for each in pod.workload["spec"].get("volumeClaimTemplates", [])}
        for volume in pod.spec["volumes"]:
            if "secret" in volume:
                assert volume["secret"]["secretName"] == f"certificate-{name}"
                assert f"certificate-{name}" in overlay.secrets()
            if "configMap" in volume:
                overlay.get("ConfigMap", volume["configMap"]["name"])
            if "persistentVolumeClaim" in volume:
                overlay.get("PersistentVolumeClaim", volume["persistentVolumeClaim"]["claimName"])
        volumes = claims | {volume["name"] for volume in pod.spec["volumes"]}
        for container in pod.containers:
            assert {each["name"] for each in container["volumeMounts"]} <= volumes
        if pod.workload["kind"] != "Job":
            assert pod.workload["spec"]["selector"]["matchLabels"] == {COMPONENT: name}
    for kind in ("Service", "PodDisruptionBudget"):
        for each in overlay.of(kind).values():
            selector = each["spec"]["selector"]
            assert selector.get("matchLabels", selector)[COMPONENT] in overlay.pods()


@every_overlay
def test_services_lead_to_ports_at_which_a_pod_listens(overlay: Overlay) -> None:
    for service in overlay.of("Service").values():
        pod = overlay.pods()[service["spec"]["selector"][COMPONENT]]
        listening = {port["name"]: port["containerPort"] for port in pod.main["ports"]}
        for port in service["spec"]["ports"]:
            assert listening[port["targetPort"]] == port["port"]


@every_overlay
def test_policies_allow_the_connections_of_the_services_and_no_others(overlay: Overlay) -> None:
    connections = set()
    for name, pod in overlay.pods().items():
        connect = overlay.environment(pod.main).get("ATHRL_CONNECT")
        if connect:
            place, port = re.fullmatch(r"tls/([a-z]+):(\d+)", connect).groups()  # type: ignore[union-attr]
            assert place in overlay.of("Service")
            connections.add((name, place, int(port)))
    assert connections == overlay.allowed()
    assert overlay.get("NetworkPolicy", "nothing-else")["spec"]["podSelector"] == {}
    senders = {
        name
        for name, policy in overlay.of("NetworkPolicy").items()
        if policy["spec"].get("egress") and name not in ("nothing-else", "certificates")
    }
    assert senders == {sender for sender, _, _ in connections}


@every_overlay
@pytest.mark.parametrize("service", SERVICES)
def test_service_is_told_and_given_what_compose_gives_it(overlay: Overlay, service: str) -> None:
    composed, pod = compose()[service], overlay.pods()[service]
    container = pod.main
    entry, arguments = overlay.command(container)
    assert container["image"].removesuffix(":gpu") == composed["image"]
    assert entry == composed.get("entrypoint")
    if service != "learner":  # its settings are arguments here, and a variable there
        assert arguments == composed.get("command", arguments)
        told = set(composed.get("environment", {})) - {"ATHRL_METRICS_LISTEN"}  # here a component's
        assert told <= set(overlay.environment(container))
    mounted = {each["mountPath"] for each in container["volumeMounts"]}
    assert mounted == {volume.split(":")[1] for volume in composed["volumes"]} | {"/tmp"}
    limits = container["resources"]["limits"]
    assert gibibytes(limits["memory"]) >= gibibytes(composed["mem_limit"])
    if service != "learner":
        assert float(limits["cpu"]) == float(composed["cpus"])
        assert gibibytes(limits["memory"]) == gibibytes(composed["mem_limit"])
    (tmp,) = [volume for volume in pod.spec["volumes"] if volume["name"] == "tmp"]
    assert composed["tmpfs"] == ["/tmp:size=256m,mode=1777"]
    assert tmp["emptyDir"] == {"medium": "Memory", "sizeLimit": "256Mi"}


@every_overlay
def test_a_service_that_drains_is_not_cut_short(overlay: Overlay) -> None:
    composed = compose()
    for name in {*STOPPING} & {*overlay.pods()}:
        assert seconds(composed[name]["stop_grace_period"]) > STOPPING[name], name
        grace = overlay.pods()[name].spec["terminationGracePeriodSeconds"]
        if (overlay.name, name) != ("spot", "actor"):  # whose node is taken away before
            assert grace == seconds(composed[name]["stop_grace_period"]), name


@every_overlay
def test_a_learner_has_as_long_as_in_containers_to_read_its_log(overlay: Overlay) -> None:
    probe = overlay.pods()["learner"].main["startupProbe"]
    image = (ROOT / "deploy" / "Dockerfile").read_text().partition("AS learner\n")[2]
    (started,) = re.findall(r"--start-period=(\d+)s", image)
    assert probe["periodSeconds"] * probe["failureThreshold"] == int(started)


@pytest.mark.parametrize("overlay", [name for name in OVERLAYS if name != "cert-manager"], indirect=True)
def test_the_job_alone_may_touch_secrets_and_only_those_of_certificates(overlay: Overlay) -> None:
    (rule,) = overlay.get("Role", "certificates")["rules"]
    assert set(rule["verbs"]) == {"get", "patch"}
    assert set(rule["resourceNames"]) == set(overlay.of("Secret"))
    assert not any("data" in secret for secret in overlay.of("Secret").values())


@every_overlay
def test_no_pod_holds_the_authoritys_key(overlay: Overlay) -> None:
    holders = {
        volume["secret"]["secretName"]
        for pod in overlay.pods().values()
        for volume in pod.spec["volumes"]
        if "secret" in volume
    }
    assert "certificate-authority" not in holders


def test_actors_of_spot_nodes_follow_the_learner() -> None:
    overlay = Overlay("spot")
    scaler = overlay.get("HorizontalPodAutoscaler", "actor")["spec"]
    (metric,) = scaler["metrics"]
    assert scaler["scaleTargetRef"]["name"] == "actor"
    assert "replicas" not in overlay.get("Deployment", "actor")["spec"]
    adapter = ROOT / "deploy/kubernetes/components/autoscaling/prometheus-adapter.yaml"
    (rule,) = yaml.safe_load(adapter.read_text())["rules"]["external"]
    assert rule["name"]["as"] == metric["external"]["metric"]["name"]


@pytest.mark.parametrize("began", [2, 20, 64])
def test_number_of_actors_settles_at_what_the_learner_needs(began: int) -> None:
    """As a cluster counts: present number times metric by goal, nothing within a tenth of the goal."""
    scaler = Overlay("spot").get("HorizontalPodAutoscaler", "actor")["spec"]
    goal = int(scaler["metrics"][0]["external"]["target"]["value"].removesuffix("m")) / 1000
    needed, actors = 20, began
    for _ in range(30):
        waiting = max(0.0, 1 - actors / needed)  # share of its time in which the learner has no data
        factor = 1 / max(1 - waiting, 0.1) / goal  # as the adapter's rule says it
        if abs(factor - 1) > 0.1:
            actors = min(max(math.ceil(actors * factor), scaler["minReplicas"]), scaler["maxReplicas"])
    assert 0.75 * needed <= actors <= needed


@every_overlay
def test_settings_are_ones_that_a_run_has(overlay: Overlay) -> None:
    learner = overlay.pods()["learner"]
    for container in learner.containers:
        given = overlay.environment(container)["ATHRL_SET"].split()
        words = overlay.command(container)[1]
        given += [word.removeprefix("--set=") for word in words if word.startswith("--set=")]
        settings = read_run_file(None, given)
        assert (settings.run.name, settings.run.folder) == ("town03", "/runs")
        assert settings.network.listen == "tls/0.0.0.0:7447"


def compose() -> dict[str, Any]:
    """The services of compose.yaml."""
    services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    for service in services.values():
        for each in ("mem_limit", "image"):
            found = re.search(r":-(\w+)}", str(service.get(each, "")))
            service[each] = found[1] if found else service.get(each)
    return services


def seconds(text: str) -> float:
    """A time as Compose writes it: 40s."""
    return float(text.removesuffix("s"))


def gibibytes(text: str) -> float:
    """Sizes as Kubernetes and Compose write them: 512Mi, 6g."""
    number, unit = re.fullmatch(r"(\d+)(\w+)", text).groups()  # type: ignore[union-attr]
    return int(number) * GIBIBYTES.get(unit, {"g": 1.0, "m": 1 / 1024}.get(unit, 0.0))
