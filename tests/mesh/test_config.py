"""The settings that open a robot to other hosts and users, and those that do not."""

from __future__ import annotations

import base64
import contextlib
import stat
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from strands_actors import Robot
from strands_actors.surfaces.mesh import TLS, Access, MeshConfig
from strands_actors.surfaces.mesh.access import access_control
from strands_actors.surfaces.mesh.certificate import common_name
from strands_actors.surfaces.mesh.config import ENVIRONMENT
from strands_actors.surfaces.mesh.keys import make

from .world import tls


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("keys") / "new"
    make(directory, hosts=["arm.example", "192.0.2.7"], robots=["robot"])
    return directory


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (MeshConfig(listen="tcp/0.0.0.0:7447"), "everyone in its network"),
        (MeshConfig(listen="tcp/192.0.2.1:7447"), "everyone in its network"),
        (MeshConfig(connect="tcp/robot.example:7447"), "everyone in its network"),
        (MeshConfig(listen="tcp/[::]:7447"), "everyone in its network"),
        (MeshConfig(listen="tcp/127.0.0.1:7447"), "every user of this host"),
        (MeshConfig(listen="tcp/localhost:0"), "every user of this host"),
        (MeshConfig(connect="tcp/[::1]:7447"), "every user of this host"),
        (
            MeshConfig(listen="tls/0.0.0.0:7447"),
            r"needs certificates. Give mesh=MeshConfig\(\.\.\., tls=TLS\(ca, certificate, key\)\)",
        ),
        (MeshConfig(listen="udp/127.0.0.1:7447"), "is not an endpoint"),
        (MeshConfig(listen="tls/0.0.0.0"), "is not an endpoint"),
        (MeshConfig(connect="tls/:7447"), "is not an endpoint"),
        (MeshConfig(connect=["tls/arm.example:port"]), "is not an endpoint"),
        (MeshConfig(connect="tls/arm.example:70000#bind=lo"), "is not an endpoint"),
        (MeshConfig(listen="7447"), "is not an endpoint"),
        (MeshConfig(listen="tls/0.0.0.0:1", tls=TLS("no.pem", "no.pem", "no.key")), "cannot be read"),
    ],
)
def test_an_open_or_invalid_endpoint_is_refused(config: MeshConfig, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        config.check()
    with pytest.raises(ValueError, match=message):
        Robot("so101", mode="real", transport="twin", mesh=config)


FILES = {"ca": "a", "certificate": "b", "key": "c"}


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"listen": "tcp/127.0.0.1:7447", "insecure": "false"}, "insecure is 'false'. Give True or False"),
        ({"listen": "tcp/127.0.0.1:7447", "insecure": 1}, "insecure is 1. Give True or False"),
        ({"listen": 5}, "listen is 5. Give an endpoint like 'tls/0.0.0.0:7447', or a list of them"),
        ({"listen": None}, "listen is None. Give"),
        ({"listen": b"tls/0.0.0.0:1"}, "listen is b'tls/0.0.0.0:1'. Give"),
        ({"listen": {"tcp/127.0.0.1:1": 2}}, "listen is {'tcp/127.0.0.1:1': 2}. Give"),
        ({"connect": [5]}, "connect is [5]. Give"),
        ({"tls": FILES}, "Give TLS(ca, certificate, key)"),
        ({"tls": TLS(5, 5, 5)}, "tls.ca is 5. Give a path"),  # type: ignore[arg-type]
        ({"access": {"viewers": "v"}}, "access is {'viewers': 'v'}. Give Access(viewers, operators)"),
        ({"access": Access(operators=7)}, "access.operators is 7. Give a name, or a list"),  # type: ignore[arg-type]
    ],
)
def test_saf_014_a_field_of_another_kind_opens_nothing(fields: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError) as refused:
        Robot("so101", mode="real", transport="twin", mesh=MeshConfig(**fields))
    assert expected in str(refused.value)


@pytest.mark.parametrize("path", [5, None, b"mesh.toml", ["mesh.toml"]])
def test_a_value_that_is_no_path_is_refused(path: Any) -> None:
    with pytest.raises(ValueError, match=r"mesh: the file is .*\. Give the path of a TOML file, as text"):
        MeshConfig.load(path)


def test_tcp_beside_tls_is_a_way_around_it(keys: Path) -> None:
    with pytest.raises(ValueError, match="would accept commands without TLS"):
        MeshConfig(listen=["tls/0.0.0.0:7447", "tcp/127.0.0.1:7448"], tls=tls(keys, "robot")).check()


def test_a_key_that_others_may_read_is_refused(keys: Path) -> None:
    config = MeshConfig(listen="tls/0.0.0.0:7447", tls=tls(keys, "robot"))
    key = keys / "robot.key"
    for mode in (0o644, 0o640, 0o604, 0o620):
        key.chmod(mode)
        with pytest.raises(
            ValueError, match=r"other users can read the private key " rf".* \(mode {mode:03o}\).*chmod 600"
        ):
            config.check()
    key.chmod(0o600)
    config.check()


def test_safe_and_explicitly_insecure_settings_are_accepted(keys: Path) -> None:
    MeshConfig().check()
    MeshConfig(listen=["tcp/127.0.0.1:7447", "tcp/localhost:0", "tcp/[::1]:0"], insecure=True).check()
    MeshConfig(listen="tcp/0.0.0.0:7447", insecure=True).check()
    MeshConfig(listen="tls/0.0.0.0:7447", tls=tls(keys, "robot")).check()


def test_by_default_nothing_listens_beyond_a_socket_of_the_user() -> None:
    config = MeshConfig()
    assert (config.listens, config.connects) == ([], [])
    rules = config.robot_settings()["access_control"]
    assert rules["default_permission"] == "deny"
    assert rules["subjects"] == [{"id": "local", "link_protocols": ["unixsock-stream"]}]


def test_a_file_gives_the_same_settings(keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = keys / "robot.toml"
    file.write_text(
        'listen = "tls/0.0.0.0:7447"\n[tls]\nca = "ca.pem"\ncertificate = "robot.pem"\nkey = "robot.key"\n'
        '[access]\nviewers = ["screen"]\n'
    )
    monkeypatch.setenv(ENVIRONMENT, str(file))
    config = MeshConfig.from_environment()
    config.check()
    assert config.listens == ["tls/0.0.0.0:7447"]
    assert config.tls == tls(keys, "robot")
    assert config.access.viewers == ["screen"]
    file.write_text('listne = "tls/0.0.0.0:7447"\n')
    with pytest.raises(ValueError, match="listne"):
        MeshConfig.from_environment()
    with pytest.raises(ValueError, match=r"nothing\.toml cannot be read"):
        MeshConfig.load(keys / "nothing.toml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('listne = "x"', "`listne`. There are listen, connect, tls, access, insecure"),
        ('[tls]\nca = "a"\ncertificate = "b"\nkey = "c"\ncert = "d"', "There are ca, certificate, key"),
        ('[access]\nviewer = "x"', "There are viewers, operators"),
        ('listen = "tls/0.0.0.0:1"', "needs certificates. Give a table [tls] with ca, certificate and key"),
        (
            'connect = "tcp/arm.example:1"',
            "Use tls/ and a table [tls] with ca, certificate and key, or set insecure = true",
        ),
    ],
)
def test_a_mistake_in_a_file_is_reported_with_the_names_of_the_file(
    tmp_path: Path, text: str, expected: str
) -> None:
    file = tmp_path / "mesh.toml"
    file.write_text(text)
    with pytest.raises(ValueError) as refused:
        MeshConfig.load(file)
    assert expected in str(refused.value)


def test_a_set_of_keys(keys: Path) -> None:
    ca = x509.load_pem_x509_certificate((keys / "ca.pem").read_bytes())
    for name in ("robot", "operator", "viewer"):
        leaf = x509.load_pem_x509_certificate((keys / f"{name}.pem").read_bytes())
        leaf.verify_directly_issued_by(ca)
        assert leaf.subject.rfc4514_string() == f"CN={name}"
        assert common_name(str(keys / f"{name}.pem")) == name
        uses = leaf.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert (ExtendedKeyUsageOID.SERVER_AUTH in uses) is (name == "robot")
        assert stat.S_IMODE((keys / f"{name}.key").stat().st_mode) == 0o600
    names = x509.load_pem_x509_certificate((keys / "robot.pem").read_bytes()).extensions
    places = names.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "arm.example" in places.get_values_for_type(x509.DNSName)
    assert "192.0.2.7" in map(str, places.get_values_for_type(x509.IPAddress))
    assert stat.S_IMODE(keys.stat().st_mode) == 0o700
    with pytest.raises(FileExistsError):
        make(keys)
    make(keys, (), robots=["later"])  # one more certificate of the same authority
    x509.load_pem_x509_certificate((keys / "later.pem").read_bytes()).verify_directly_issued_by(ca)


@pytest.mark.parametrize(
    ("names", "robots", "expected"),
    [
        (["a/b"], [], "not valid"),
        ([], ["a*"], "not valid"),
        (["ca"], [], "not valid"),
        (["x"], ["x"], "name of a robot"),
    ],
)
def test_invalid_names_are_refused(tmp_path: Path, names: list[str], robots: list[str], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        make(tmp_path / "keys", names, robots=robots)
    assert not (tmp_path / "keys").exists()


def test_a_name_is_read_from_a_certificate_and_from_nothing_else(keys: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.pem"
    for content in (b"", b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----", b"\xff" * 100):
        other.write_bytes(content)
        with pytest.raises(ValueError, match="is not a certificate"):
            common_name(str(other))
    whole = (keys / "robot.pem").read_bytes().split(b"\n")
    der = base64.b64decode(b"".join(whole[1:-2]))
    for cut in range(0, len(der), 7):
        cut_off = base64.encodebytes(der[:cut])
        other.write_bytes(b"-----BEGIN CERTIFICATE-----\n" + cut_off + b"-----END CERTIFICATE-----\n")
        with contextlib.suppress(ValueError):  # the name precedes the key, which may be cut off
            assert common_name(str(other)) == "robot"


@pytest.mark.parametrize(
    ("operators", "expected"),
    [(["alice", "alice.smith"], "could receive"), (["a*"], "not valid"), (["x" * 41], "too long")],
)
def test_operator_names_that_could_receive_each_others_answers_are_refused(
    keys: Path, operators: list[str], expected: str
) -> None:
    access = Access(operators=operators)
    with pytest.raises(ValueError, match=expected):
        MeshConfig(listen="tls/0.0.0.0:7447", tls=tls(keys, "robot"), access=access).check()


def granted(role: str) -> list[dict[str, Any]]:
    control = access_control(["viewer"], ["operator"])
    assert control["default_permission"] == "deny"
    names = {subject["id"]: subject.get("cert_common_names") for subject in control["subjects"]}
    rules: list[str] = next(
        policy["rules"] for policy in control["policies"] if names[policy["subjects"][0]] == [role]
    )
    return [rule for rule in control["rules"] if rule["id"] in rules]


def test_a_viewer_may_put_nothing() -> None:
    assert not [rule for rule in granted("viewer") if "put" in rule["messages"] and "ingress" in rule["flows"]]


def test_an_operator_may_put_orders_and_nothing_else() -> None:
    (orders,) = [rule for rule in granted("operator") if "put" in rule["messages"] and "ingress" in rule["flows"]]
    assert sorted(orders["key_exprs"]) == [
        "strands/*/actor/gateway/stop",
        "strands/*/cmd",
        "strands/broadcast",
        "strands/safety/estop",
        "strands/safety/resume",
    ]


def test_an_operator_sends_only_under_its_own_name() -> None:
    (questions,) = [rule for rule in granted("operator") if "query" in rule["messages"]]
    assert sorted(questions["key_exprs"]) == [
        "strands/*/actor/gateway/from/operator.$*",
        "strands/*/cmd/operator.$*",
    ]
    assert not [rule for rule in granted("viewer") if "query" in rule["messages"]]
