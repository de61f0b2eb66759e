"""What KEDA and cert-manager take, as far as our manifests use it; their own schemas come with a cluster.

Written from the references of `keda.sh/v1alpha1` and `cert-manager.io/v1`: a key that is not in them is an
error, as it is for a cluster that applies with strict validation.
"""

from __future__ import annotations

from typing import Any

import jsonschema

TEXT: dict[str, Any] = {"type": "string", "minLength": 1}
COUNT: dict[str, Any] = {"type": "integer", "minimum": 0}
DURATION: dict[str, Any] = {"type": "string", "pattern": "^([0-9]+h)?([0-9]+m)?([0-9]+s)?$", "minLength": 2}


def only(required: dict[str, Any], optional: dict[str, Any] | None = None) -> dict[str, Any]:
    """The schema of an object with these keys and no others."""
    return {
        "type": "object",
        "properties": {**required, **(optional or {})},
        "required": [*required],
        "additionalProperties": False,
    }


SCALING = only(
    {
        "policies": {
            "type": "array",
            "minItems": 1,
            "items": only(
                {"type": {"enum": ["Percent", "Pods"]}, "value": COUNT, "periodSeconds": {"maximum": 1800}}
            ),
        }
    },
    {"stabilizationWindowSeconds": {"type": "integer", "minimum": 0, "maximum": 3600}},
)
SCALED_OBJECT = only(
    {
        "scaleTargetRef": only({"name": TEXT}, {"apiVersion": TEXT, "kind": TEXT}),
        "triggers": {
            "type": "array",
            "minItems": 1,
            "items": only(
                {
                    "type": {"const": "prometheus"},
                    "metadata": only(
                        {"serverAddress": TEXT, "query": TEXT, "threshold": TEXT},
                        {"activationThreshold": TEXT, "ignoreNullValues": {"enum": ["true", "false"]}},
                    ),
                },
                {"metricType": {"enum": ["AverageValue", "Value"]}, "name": TEXT},
            ),
        },
    },
    {
        "minReplicaCount": COUNT,
        "maxReplicaCount": COUNT,
        "pollingInterval": COUNT,
        "cooldownPeriod": COUNT,
        "advanced": only(
            {
                "horizontalPodAutoscalerConfig": only(
                    {"behavior": only({}, {"scaleUp": SCALING, "scaleDown": SCALING})}
                )
            }
        ),
    },
)
CERTIFICATE = only(
    {
        "secretName": TEXT,
        "commonName": {**TEXT, "maxLength": 64},
        "issuerRef": only(
            {
                "name": TEXT,
                "kind": {"enum": ["Issuer", "ClusterIssuer"]},
                "group": {"const": "cert-manager.io"},
            }
        ),
    },
    {
        "isCA": {"type": "boolean"},
        "dnsNames": {"type": "array", "items": TEXT},
        "duration": DURATION,
        "renewBefore": DURATION,
        "usages": {"items": {"enum": ["digital signature", "server auth", "client auth", "cert sign"]}},
        "privateKey": only(
            {"algorithm": {"const": "ECDSA"}, "size": {"enum": [256, 384, 521]}},
            {"encoding": {"enum": ["PKCS1", "PKCS8"]}, "rotationPolicy": {"enum": ["Never", "Always"]}},
        ),
    },
)
ISSUER = {"oneOf": [only({"selfSigned": {"type": "object"}}), only({"ca": only({"secretName": TEXT})})]}

SPECS = {
    ("keda.sh/v1alpha1", "ScaledObject"): SCALED_OBJECT,
    ("cert-manager.io/v1", "Certificate"): CERTIFICATE,
    ("cert-manager.io/v1", "Issuer"): ISSUER,
}
"""The schema of the spec of each kind that is no cluster's own."""


def is_custom(resource: dict[str, Any]) -> bool:
    """Whether a resource is of a kind that an operator brings."""
    return (resource["apiVersion"], resource["kind"]) in SPECS


def validate(resource: dict[str, Any]) -> None:
    """Raise `jsonschema.ValidationError` unless it is what its operator takes."""
    spec = SPECS[resource["apiVersion"], resource["kind"]]
    whole = only({"apiVersion": TEXT, "kind": TEXT, "metadata": {"type": "object"}, "spec": spec})
    jsonschema.validate(resource, whole)
