"""Starts what an overlay says as containers of a Docker engine: a cluster's part, on one machine.

Pods become containers with the same image, user, arguments, variables, volumes, limits and rights. Volumes
are folders of this machine with the modes that a cluster gives them. For each connection that the policies
allow there is a network of its own, without a way out, on which the receiver has its service's name: what is
not allowed has no way at all.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.compose.containers import output, said, wait
from tests.kubernetes.cluster_api import ClusterApi
from tests.kubernetes.manifests import Object, Overlay, Pod

PROJECT = "athrl-kubernetes-check"
API_NETWORK = f"{PROJECT}-api"
JOB_SECONDS = 120.0
SIZES = {"Ki": "k", "Mi": "m", "Gi": "g"}
ACCOUNT = "/var/run/secrets/kubernetes.io/serviceaccount"


@dataclass
class Engine:
    """The pods of an overlay as containers.

    Attributes:
        overlay: says what to start.
        folder: for volumes; users of containers may pass through it.
        api: keeps the secrets.
        api_host: address of this machine at which containers reach the API.
        started: containers by the names of their workloads.
    """

    overlay: Overlay
    folder: Path
    api: ClusterApi
    api_host: str
    started: dict[str, str] = field(default_factory=dict)

    def start(self, name: str) -> str:
        """Start a workload's pod once, whatever its replicas; return the container's id."""
        pod = self.overlay.pods()[name]
        for container in pod.init_containers:
            self._run_to_its_end(pod, container)
        words = [
            "docker",
            "create",
            "--name",
            f"{PROJECT}-{name}",
            "--hostname",
            f"{name}-0",
            "--restart",
            "always",
        ]
        container = output(*words, *self._options(pod, pod.main)).strip()
        for network, aliases in self._networks(name).items():
            output("docker", "network", "connect", *aliases, network, container)
        output("docker", "start", container)
        self.started[name] = container
        return container

    def run_job(self, name: str) -> None:
        """Run a job's pod to its end, which has to be a good one."""
        pod = self.overlay.pods()[name]
        self._run_to_its_end(pod, pod.main)

    def ready(self, name: str) -> bool:
        """Whether the container's readiness probe succeeds."""
        probe = self.overlay.pods()[name].main["readinessProbe"]
        command = ["docker", "exec", self.started[name], *probe["exec"]["command"]]
        seconds = probe["timeoutSeconds"] * 5  # this machine is shared, and slower than it would be
        return subprocess.run(command, capture_output=True, timeout=seconds).returncode == 0

    def await_ready(self, name: str, seconds: float = 300) -> None:
        """Wait until a pod would be ready."""
        wait(f"{name} to be ready", lambda: self.ready(name), seconds)

    def make_networks(self) -> None:
        """Make a network for each connection that the policies allow."""
        for sender, receiver, _ in self.overlay.allowed():
            output("docker", "network", "create", "--internal", network_of(sender, receiver))
        output("docker", "network", "create", "--internal", f"{PROJECT}-alone")

    def tell(self) -> None:
        """Print the last lines that each container said."""
        for name, container in self.started.items():
            print(f"{name}: {said(container)[-2000:]}")

    def _networks(self, name: str) -> dict[str, list[str]]:
        """The networks of a pod beside the first, with its names there."""
        networks = {}
        for sender, receiver, _ in sorted(self.overlay.allowed()):
            if name in (sender, receiver):
                networks[network_of(sender, receiver)] = ["--alias", name] if name == receiver else []
        return networks

    def _run_to_its_end(self, pod: Pod, container: Object) -> None:
        words = ["docker", "run", "--rm", "--name", f"{PROJECT}-{pod.name}-{container['name']}"]
        output(*words, *self._options(pod, container), seconds=JOB_SECONDS)

    def _options(self, pod: Pod, container: Object) -> list[str]:
        """The options of `docker create`, the image and the arguments."""
        rights, limits = pod.spec["securityContext"], container["resources"]["limits"]
        own = container["securityContext"]
        assert own["readOnlyRootFilesystem"]
        assert not own["allowPrivilegeEscalation"]
        options = ["--read-only", "--security-opt", "no-new-privileges:true"]
        options += [
            "--user",
            f"{rights['runAsUser']}:{rights['runAsGroup']}",
            "--group-add",
            str(rights["fsGroup"]),
        ]
        options += [word for each in own["capabilities"]["drop"] for word in ("--cap-drop", each)]
        options += ["--memory", size(limits["memory"])]
        options += ["--cpus", str(limits["cpu"])] if "cpu" in limits else []
        environment = self.overlay.environment(container)
        if pod.spec.get("automountServiceAccountToken", True):
            options += ["--volume", f"{self.api.account}:{ACCOUNT}:ro"]
            environment |= {
                "KUBERNETES_SERVICE_HOST": self.api_host,
                "KUBERNETES_SERVICE_PORT": str(self.api.port),
            }
        else:
            options += ["--network", f"{PROJECT}-alone"]
        options += [word for key, value in environment.items() for word in ("--env", f"{key}={value}")]
        for mount in container["volumeMounts"]:
            options += self._mount(pod, mount)
        entry, arguments = self.overlay.command(container)
        if entry:
            options += ["--entrypoint", entry[0]]
        return [*options, container["image"], *(entry or [])[1:], *arguments]

    def _mount(self, pod: Pod, mount: Object) -> list[str]:
        """The option for one volume; its folder is made when it is first asked for."""
        claimed = pod.workload["spec"].get("volumeClaimTemplates", [])
        volumes = {volume["name"]: volume for volume in pod.spec["volumes"]}
        volumes |= {each["metadata"]["name"]: {"claim": each["metadata"]["name"]} for each in claimed}
        volume, group = volumes[mount["name"]], pod.spec["securityContext"]["fsGroup"]
        empty = volume.get("emptyDir", {})
        if empty.get("medium") == "Memory":
            return ["--tmpfs", f"{mount['mountPath']}:size={size(empty['sizeLimit'])},mode=1777"]
        claim = volume.get("claim") or volume.get("persistentVolumeClaim", {}).get("claimName")
        folder = self.folder / (claim or f"{pod.name}-{mount['name']}")
        if "secret" in volume:
            secret = volume["secret"]
            files = self.api.secrets[secret["secretName"]]
            content = {item["path"]: base64.b64decode(files[item["key"]]) for item in secret["items"]}
            write(folder, content, secret["defaultMode"], group)
        elif "configMap" in volume:
            texts = self.overlay.get("ConfigMap", volume["configMap"]["name"])["data"]
            write(folder, {name: text.encode() for name, text in texts.items()}, 0o644, group)
        elif not folder.exists():
            folder.mkdir()  # a cluster's is empty, too
            os.chown(folder, 0, group)
            folder.chmod(0o2775 if claim else 0o777)
        return ["--volume", f"{folder}:{mount['mountPath']}{':ro' if mount.get('readOnly') else ''}"]


def write(folder: Path, files: dict[str, bytes], mode: int, group: int) -> None:
    """Make a folder with files of root's that a group may read."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
        os.chown(folder / name, 0, group)
        (folder / name).chmod(mode)
    folder.chmod(0o755)


def network_of(sender: str, receiver: str) -> str:
    """The name of the network for a connection."""
    return f"{PROJECT}-{sender}-to-{receiver}"


def size(quantity: str) -> str:
    """A size of Kubernetes as Docker writes it: 512Mi is 512m."""
    return quantity[:-2] + SIZES[quantity[-2:]]


def make_api_network() -> str:
    """Make the network of pods that ask the cluster's API; return this machine's address in it."""
    output("docker", "network", "create", "--internal", API_NETWORK)
    network: list[dict[str, Any]] = json.loads(output("docker", "network", "inspect", API_NETWORK))
    return str(network[0]["IPAM"]["Config"][0]["Gateway"])


def remove_all() -> None:
    """Remove the containers and networks of this and of an earlier check."""
    for each in output("docker", "ps", "--all", "--quiet", "--filter", f"name={PROJECT}").split():
        output("docker", "rm", "--force", each)
    for each in output("docker", "network", "ls", "--quiet", "--filter", f"name={PROJECT}").split():
        output("docker", "network", "rm", each)


def reaches(container: str, host: str, port: int) -> bool:
    """Whether a container can open a connection to a host by its name."""
    script = f"import socket; socket.create_connection(({host!r}, {port}), 10).close()"
    command = ["docker", "exec", container, "python", "-c", script]
    return subprocess.run(command, capture_output=True, timeout=120).returncode == 0
