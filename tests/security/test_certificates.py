"""`athrl certificates`: its files are not overwritten, can be renewed, and keys are private."""

from __future__ import annotations

import stat
import subprocess
from pathlib import Path

import pytest
from athrl.errors import CommandError
from athrl_protocol.security.certificates import ROLES, SERVERS
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from athrl import certificates

ROOT = Path(__file__).parents[2]


def certificate(folder: Path, role: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / role / "tls.crt").read_bytes())


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_role_has_its_own_and_a_key_that_only_its_owner_reads(tmp_path: Path) -> None:
    folder = tmp_path / "certificates"
    certificates.make_all(folder, ["learner.example", "10.0.0.7"], days=30)
    authority = certificate(folder, "authority")
    for role in ROLES:
        made = certificate(folder, role)
        made.verify_directly_issued_by(authority)
        assert isinstance(made.public_key(), ec.EllipticCurvePublicKey)
        assert made.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == role
        purposes = set(made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        assert (ExtendedKeyUsageOID.SERVER_AUTH in purposes) == (role in SERVERS)
        lifetime = made.not_valid_after_utc - made.not_valid_before_utc
        assert lifetime.days == 30
        assert sorted(path.name for path in (folder / role).iterdir()) == ["ca.crt", "tls.crt", "tls.key"]
    for path in folder.rglob("*.key"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    for path in [folder / role for role in (*ROLES, "authority")]:
        assert stat.S_IMODE(path.stat().st_mode) == 0o700
    for role in SERVERS:
        names = certificate(folder, role).extensions.get_extension_for_class(x509.SubjectAlternativeName)
        assert names.value.get_values_for_type(x509.DNSName) == ["learner.example", role]
        assert [str(address) for address in names.value.get_values_for_type(x509.IPAddress)] == ["10.0.0.7"]


def test_nothing_is_overwritten(command, tmp_path: Path) -> None:
    folder = tmp_path / "certificates"
    assert command.run("certificates", str(folder), seconds=60).returncode == 0
    before = contents(folder)
    again = command.run("certificates", str(folder), seconds=60)
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert "not overwritten" in again.stderr
    assert contents(folder) == before
    assert command.run("certificates", str(folder), "--if-missing", seconds=60).returncode == 0
    assert contents(folder) == before


def test_what_is_missing_or_ends_soon_is_made(tmp_path: Path) -> None:
    certificates.make_all(tmp_path, ["localhost"], days=365)
    (tmp_path / "viewer" / "tls.key").unlink()
    assert certificates.complete(tmp_path, ["localhost"], days=365) == ["viewer"]
    certificates.renew_roles(tmp_path, ["actor"], None, days=1)
    assert certificates.complete(tmp_path, ["localhost"], days=365) == []
    identity = certificates._load_authority(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(certificates, "CLOCK_DIFFERENCE", certificates.datetime.timedelta(days=10))
        certificates._write_role(
            tmp_path / "actor", certificates._new_role(identity, "actor", [], days=2), identity
        )
    assert certificates.complete(tmp_path, ["localhost"], days=365) == ["actor"]


def test_servers_get_a_name_that_they_lack(tmp_path: Path) -> None:
    certificates.make_all(tmp_path, ["localhost", "::1"], days=365)
    assert certificates.complete(tmp_path, ["localhost"], 365, required=["localhost", "0:0::1"]) == []
    assert certificates.complete(tmp_path, ["new.example"], 365, required=["new.example"]) == [*SERVERS]


def test_servers_that_are_renewed_in_time_keep_their_names_unless_some_are_given(tmp_path: Path) -> None:
    certificates.make_all(tmp_path, ["learner.example", "::1"], days=365)
    (tmp_path / "learner" / "tls.key").unlink()
    assert certificates.complete(tmp_path, ["localhost"], days=365) == ["learner"]
    names = certificates.names_in(tmp_path / "learner" / "tls.crt")
    assert names == ["localhost", "learner.example", "::1", "learner"]
    (tmp_path / "learner" / "tls.key").unlink()
    assert certificates.complete(tmp_path, ["new.example"], 365, required=iter(["new.example"])) == [*SERVERS]
    assert certificates.names_in(tmp_path / "learner" / "tls.crt") == ["new.example", "learner"]


def test_renewal_changes_one_role_and_keeps_authority_and_names(tmp_path: Path) -> None:
    certificates.make_all(tmp_path, ["learner.example", "::1"], days=365)
    before = contents(tmp_path)
    certificates.renew_roles(tmp_path, ["learner"], None, days=365)
    after = contents(tmp_path)
    assert {name for name in before if before[name] != after[name]} == {"learner/tls.crt", "learner/tls.key"}
    certificate(tmp_path, "learner").verify_directly_issued_by(certificate(tmp_path, "authority"))
    names = certificate(tmp_path, "learner").extensions.get_extension_for_class(x509.SubjectAlternativeName)
    assert names.value.get_values_for_type(x509.DNSName) == ["learner.example", "learner"]


def test_renewal_gives_every_server_the_names_that_are_given_once(tmp_path: Path) -> None:
    certificates.make_all(tmp_path, ["localhost"], days=365)
    certificates.renew_roles(tmp_path, SERVERS, iter(["new.example"]), days=365)
    assert all(certificates._has_names(tmp_path / role, ["new.example"]) for role in SERVERS)


def test_wrong_words_are_one_line_each(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="no such role; it is one of learner, actor"):
        certificates.renew_roles(tmp_path, ["boss"], None, days=1)
    with pytest.raises(CommandError, match=r"cannot read .*authority/tls.crt: no such file"):
        certificates.renew_roles(tmp_path, ["actor"], None, days=1)
    for wrong in ("a b", "", "-", "host:7447", "héros"):
        with pytest.raises(CommandError, match="neither a host name nor an address"):
            certificates._hosts([wrong])


@pytest.mark.parametrize("options", [[], ["--if-missing"], ["--renew", "actor"]])
@pytest.mark.parametrize("folder", ["README.md", "README.md/x"])
def test_file_in_place_of_the_folder_is_named_and_left_alone(
    command, folder: str, options: list[str]
) -> None:
    file = command.folder / "README.md"
    file.write_text("read me")
    result = command.run("certificates", folder, *options, seconds=30)
    assert result.returncode == 2
    assert result.stderr.splitlines() == [
        f"athrl: {folder}: README.md is a file, it should be a folder or not exist yet"
    ]
    assert file.read_text() == "read me"


def test_folder_that_became_a_file_is_one_line_too(tmp_path: Path) -> None:
    (tmp_path / "authority").write_text("no folder")
    with pytest.raises(CommandError, match=r"cannot write .*/authority/tls\.key: "):
        certificates.make_all(tmp_path, ["localhost"], days=365)


def test_failed_writing_leaves_the_old_pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certificates.make_all(tmp_path, ["localhost"], days=365)
    before = contents(tmp_path)

    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(certificates.os, "fsync", fail)
    with pytest.raises(CommandError, match="no space left"):
        certificates.renew_roles(tmp_path, ["actor"], None, days=365)
    assert contents(tmp_path) == before


def test_no_private_key_is_in_the_repository() -> None:
    # The words are put together here so that this file does not hold them.
    words = "PRIVATE " + "KEY-----"
    found = subprocess.run(
        ["git", "grep", "--text", "--files-with-matches", "-e", words],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert found.returncode == 1, found.stdout
