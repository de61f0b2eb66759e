"""What Kustomize makes of the manifests, by what a cluster would do with it."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
KUBERNETES = ROOT / "deploy" / "kubernetes"
OVERLAYS = sorted(folder.name for folder in (KUBERNETES / "overlays").iterdir())
COMPONENT = "app.kubernetes.io/component"
WORKLOADS = ("Deployment", "StatefulSet", "Job")

Object = dict[str, Any]


@cache
def rendered(overlay: str) -> str:
    """What `kubectl kustomize` prints."""
    result = subprocess.run(
        ["kubectl", "kustomize", str(KUBERNETES / "overlays" / overlay)],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout


@dataclass(frozen=True)
class Pod:
    """A workload's pod; every name in it is looked up in the overlay.

    Attributes:
        name: the workload's, and its component's.
        spec: of the pod, as a cluster gets it.
    """

    name: str
    workload: Object
    spec: Object

    @property
    def init_containers(self) -> list[Object]:
        return self.spec.get("initContainers", [])

    @property
    def containers(self) -> list[Object]:
        return [*self.init_containers, *self.spec["containers"]]

    @property
    def main(self) -> Object:
        (container,) = self.spec["containers"]
        return container


class Overlay:
    """The objects of an overlay."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.objects: list[Object] = list(yaml.safe_load_all(rendered(name)))

    def of(self, kind: str) -> dict[str, Object]:
        """The objects of a kind by their names."""
        return {each["metadata"]["name"]: each for each in self.objects if each["kind"] == kind}

    def get(self, kind: str, name: str) -> Object:
        return self.of(kind)[name]

    def secrets(self) -> set[str]:
        """Names of the secrets that are in the overlay, or that cert-manager makes for it."""
        made = {each["spec"]["secretName"] for each in self.of("Certificate").values()}
        return made | set(self.of("Secret"))

    def pods(self) -> dict[str, Pod]:
        """The pods by the names of their workloads."""
        pods = {}
        for kind in WORKLOADS:
            for name, workload in self.of(kind).items():
                template = workload["spec"]["template"]
                assert template["metadata"]["labels"][COMPONENT] == name
                pods[name] = Pod(name, workload, template["spec"])
        return pods

    def environment(self, container: Object) -> dict[str, str]:
        """A container's variables, with those that others name filled in."""
        values: dict[str, str] = {}
        for source in container.get("envFrom", []):
            values |= self.get("ConfigMap", source["configMapRef"]["name"])["data"]
        for variable in container.get("env", []):
            values[variable["name"]] = expanded(variable["value"], values)
        return values

    def command(self, container: Object) -> tuple[list[str] | None, list[str]]:
        """What replaces the image's entry point, None: nothing does; and the arguments."""
        values = self.environment(container)
        given = container.get("command")
        arguments = [expanded(word, values) for word in container.get("args", [])]
        return given and [expanded(word, values) for word in given], arguments

    def allowed(self) -> set[tuple[str, str, int]]:
        """Who may connect to whom, at which port: what a sender's and a receiver's policy both allow."""
        senders, receivers = set(), set()
        for policy in self.of("NetworkPolicy").values():
            own = policy["spec"]["podSelector"].get("matchLabels", {}).get(COMPONENT)
            for rule in policy["spec"].get("egress", []):
                senders |= {
                    (own, other, port) for other in _pods(rule.get("to", [])) for port in _ports(rule)
                }
            for rule in policy["spec"].get("ingress", []):
                receivers |= {(other, own, port) for other in _pods(rule["from"]) for port in _ports(rule)}
        return senders & receivers


def expanded(text: str, values: dict[str, str]) -> str:
    """`$(NAME)` replaced, as a cluster does."""
    return re.sub(r"\$\(([A-Z_]+)\)", lambda found: values.get(found[1], found[0]), text)


def _pods(peers: list[Object]) -> list[str]:
    """The components that a rule names."""
    selectors = [peer["podSelector"] for peer in peers if "podSelector" in peer]
    return [selector["matchLabels"][COMPONENT] for selector in selectors]


def _ports(rule: Object) -> list[int]:
    return [each["port"] for each in rule.get("ports", [])]
