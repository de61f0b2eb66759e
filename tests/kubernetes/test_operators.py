"""The overlays for KEDA and cert-manager ask for what these operators take and our services need."""

from __future__ import annotations

import copy
import datetime
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from athrl.certificates import CLOCK_DIFFERENCE
from athrl_protocol import ProtocolError
from athrl_protocol.security.certificates import ROLES, SERVERS, Certificates
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from tests.kubernetes import custom_resources
from tests.kubernetes.manifests import Object, Overlay

USAGES = {"server auth": ExtendedKeyUsageOID.SERVER_AUTH, "client auth": ExtendedKeyUsageOID.CLIENT_AUTH}
YEAR = datetime.timedelta(days=365)


def test_keda_scales_actors_as_the_autoscaler_of_the_cluster_does() -> None:
    overlay, known = Overlay("keda"), Overlay("spot").get("HorizontalPodAutoscaler", "actor")["spec"]
    scaled = overlay.get("ScaledObject", "actor")["spec"]
    assert not overlay.of("HorizontalPodAutoscaler")
    assert "replicas" not in overlay.get("Deployment", "actor")["spec"]
    assert scaled["scaleTargetRef"]["name"] == known["scaleTargetRef"]["name"]
    assert scaled["minReplicaCount"] == known["minReplicas"]
    assert scaled["maxReplicaCount"] == known["maxReplicas"]
    assert scaled["advanced"]["horizontalPodAutoscalerConfig"]["behavior"] == known["behavior"]
    (trigger,) = scaled["triggers"]
    goal = known["metrics"][0]["external"]["target"]
    assert trigger["metricType"] == goal["type"]
    assert float(trigger["metadata"]["threshold"]) * 1000 == float(goal["value"].removesuffix("m"))


@pytest.mark.parametrize("damage", ["key", "threshold", "trigger"])
def test_what_keda_would_refuse_is_refused_here(damage: str) -> None:
    scaled = copy.deepcopy(Overlay("keda").get("ScaledObject", "actor"))
    if damage == "key":
        scaled["spec"]["maxReplicas"] = 4
    elif damage == "threshold":
        scaled["spec"]["triggers"][0]["metadata"]["threshold"] = 1.15
    else:
        scaled["spec"]["triggers"] = []
    with pytest.raises(jsonschema.ValidationError):
        custom_resources.validate(scaled)


def test_cert_manager_makes_the_secret_of_every_role_and_no_job_is_left() -> None:
    overlay = Overlay("cert-manager")
    made = {each["spec"]["secretName"] for each in overlay.of("Certificate").values()}
    assert made == {f"certificate-{role}" for role in (*ROLES, "authority")}
    left = {kind for kind in ("Job", "Secret", "Role", "RoleBinding", "ServiceAccount") if overlay.of(kind)}
    assert not left
    assert all("keep-secrets" not in name for name in overlay.of("ConfigMap"))
    issuers, of_authority = overlay.of("Issuer"), {"ca": {"secretName": "certificate-authority"}}
    for name, each in overlay.of("Certificate").items():
        issuer = issuers[each["spec"]["issuerRef"]["name"]]["spec"]
        assert issuer == ({"selfSigned": {}} if name == "authority" else of_authority)


@pytest.mark.parametrize("role", ROLES)
def test_certificates_as_cert_manager_makes_them_serve_only_for_learner_and_router(
    role: str, tmp_path: Path
) -> None:
    certificates = Overlay("cert-manager").of("Certificate")
    authority_key, authority = issue(certificates["authority"]["spec"])
    key, own = issue(certificates[role]["spec"], by=(authority_key, authority))
    write(tmp_path / "ca.crt", authority)
    write(tmp_path / "tls.crt", own)
    (tmp_path / "tls.key").write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    found = Certificates(tmp_path / "ca.crt", tmp_path / "tls.crt", tmp_path / "tls.key")
    assert own.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == role
    if role in SERVERS:
        found.check_may_serve(role)
        names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert names.get_values_for_type(x509.DNSName) == [role]
    else:
        with pytest.raises(ProtocolError, match="is no certificate that clients of a"):
            found.check_may_serve(role)


def issue(
    spec: Object, by: tuple[ec.EllipticCurvePrivateKey, x509.Certificate] | None = None
) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """A key and its certificate as the spec asks for, signed by itself or by an authority."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.datetime.now(datetime.UTC)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, spec["commonName"])])
    signer, issuer = (key, subject) if by is None else (by[0], by[1].subject)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_DIFFERENCE)
        .not_valid_after(now + YEAR)
        .add_extension(x509.BasicConstraints(ca=spec.get("isCA", False), path_length=None), critical=True)
    )
    extended: list[Any] = [USAGES[each] for each in spec.get("usages", ()) if each in USAGES]
    if extended:
        builder = builder.add_extension(x509.ExtendedKeyUsage(extended), critical=False)
    if "dnsNames" in spec:
        names = [x509.DNSName(name) for name in spec["dnsNames"]]
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return key, builder.sign(signer, hashes.SHA256())


def write(path: Path, certificate: x509.Certificate) -> None:
    path.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
