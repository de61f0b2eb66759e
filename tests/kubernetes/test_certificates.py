"""The job `certificates` makes what is missing, keeps what is good, and says in one line what it lacks."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography import x509

from tests.kubernetes.cluster_api import ClusterApi
from tests.kubernetes.manifests import KUBERNETES

ROLES = ("authority", "learner", "actor", "evaluator", "viewer", "router")


@pytest.fixture
def api(tmp_path: Path) -> Iterator[ClusterApi]:
    with ClusterApi(tmp_path, [f"certificate-{role}" for role in ROLES], "127.0.0.1").serving() as api:
        yield api


def job(api: ClusterApi, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the job's program as its pod does, in an empty folder."""
    environment = {
        "KUBERNETES_SERVICE_HOST": "127.0.0.1",
        "KUBERNETES_SERVICE_PORT": str(api.port),
        "SERVICE_ACCOUNT": str(api.account),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    return subprocess.run(
        [sys.executable, str(KUBERNETES / "base/keep_secrets.py"), "--folder", str(folder),
         "--names", "learner,router"],
        env={**os.environ, **environment}, capture_output=True, text=True, timeout=120,
    )  # fmt: skip


def test_each_role_gets_its_certificate_and_the_authoritys_key_stays_alone(
    api: ClusterApi, tmp_path: Path
) -> None:
    result = job(api, tmp_path / "first")
    assert result.returncode == 0, result.stderr
    for role in ROLES[1:]:
        assert set(api.secrets[f"certificate-{role}"]) == {"ca.crt", "tls.crt", "tls.key"}
    assert "tls.key" in api.secrets["certificate-authority"]
    served = certificate(api, "learner").extensions.get_extension_for_class(x509.SubjectAlternativeName)
    assert {"learner", "router"} <= set(served.value.get_values_for_type(x509.DNSName))


def test_a_second_job_changes_nothing_but_what_is_gone(api: ClusterApi, tmp_path: Path) -> None:
    assert job(api, tmp_path / "first").returncode == 0
    before = {name: dict(files) for name, files in api.secrets.items()}
    second = job(api, tmp_path / "second")
    assert second.returncode == 0, second.stderr
    assert api.secrets == before
    api.secrets["certificate-actor"].clear()
    assert job(api, tmp_path / "third").returncode == 0
    changed = {name for name, files in api.secrets.items() if files != before[name]}
    assert changed == {"certificate-actor"}
    assert certificate(api, "actor").issuer == certificate(api, "authority").subject


def test_a_secret_that_is_not_there_is_named_in_one_line(api: ClusterApi, tmp_path: Path) -> None:
    del api.secrets["certificate-viewer"]
    result = job(api, tmp_path / "first")
    assert result.returncode == 1
    (line,) = result.stderr.splitlines()
    assert "certificate-viewer" in line
    assert "403 Forbidden" in line


def test_an_answer_that_breaks_off_is_told_in_one_line(api: ClusterApi, tmp_path: Path) -> None:
    api.breaks_off = True
    result = job(api, tmp_path / "first")
    assert result.returncode == 1
    (line,) = result.stderr.splitlines()
    assert "the cluster's API does not answer at https://127.0.0.1" in line


def certificate(api: ClusterApi, role: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate(base64.b64decode(api.secrets[f"certificate-{role}"]["tls.crt"]))
