"""The keys of a team: what is written, who can read it, and what is refused."""

import datetime
import json
import os
import stat

import pytest

from gspn_framework_package.cli.main import main
from gspn_framework_package.model.errors import KeysError
from gspn_framework_package.team import keys
from gspn_framework_package.team.keys import NewMember

MEMBERS = [
    NewMember("robot_1", "robot"),
    NewMember("robot 2", "robot", ("10.0.0.2",)),
    NewMember("ann", "operator"),
    NewMember("hub", "router", ("127.0.0.1", "hub.lan")),
]


@pytest.fixture
def team(tmp_path):
    folder = str(tmp_path / "keys")
    keys.make_team(folder, MEMBERS, 30)
    return folder


def read(path):
    with open(path) as file:
        return file.read()


def own(folder, name):
    return os.path.join(folder, name)


def test_each_member_gets_a_folder_that_stands_alone(team, tmp_path):
    os.rename(own(team, "robot_1"), str(tmp_path / "copied"))
    found = keys.read_keys(str(tmp_path / "copied"))
    assert found.member.name == found.member.common_name == "robot_1"
    assert [m.name for m in found.members] == ["robot_1", "robot 2", "ann", "hub"]


def test_only_the_owner_can_read_anything(team):
    for folder, folders, files in os.walk(team):
        for name in files:
            assert stat.S_IMODE(os.stat(os.path.join(folder, name)).st_mode) == 0o600
        for name in folders:
            assert stat.S_IMODE(os.stat(os.path.join(folder, name)).st_mode) == 0o700


def test_a_certificate_is_signed_by_the_authority_and_holds_name_and_addresses(team):
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec

    authority = keys.read_certificate(os.path.join(team, "authority", "certificate.pem"))
    hub = keys.read_certificate(os.path.join(team, "hub", "certificate.pem"))
    authority.public_key().verify(
        hub.signature, hub.tbs_certificate_bytes, ec.ECDSA(hashes.SHA256())
    )
    names = hub.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["hub.lan"]
    assert [str(a) for a in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1"]
    assert hub.subject.rfc4514_string() == "CN=hub"


def test_nothing_is_overwritten(team):
    before = read(own(team, "team.json"))
    with pytest.raises(KeysError, match="already exists; nothing was written"):
        keys.make_team(team, MEMBERS, 30)
    with pytest.raises(KeysError, match="'ann' already has keys"):
        keys.add_members(team, [NewMember("ann", "robot")], 30)
    assert read(own(team, "team.json")) == before


def test_a_refused_team_leaves_nothing_behind(tmp_path):
    folder = tmp_path / "keys"
    with pytest.raises(KeysError, match="neither a host name nor an IP address"):
        keys.make_team(str(folder), [NewMember("hub", "router", ("no such host",))], 30)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", "..", "a/b", "-x", "authority", "a*", "x" * 49, "a\nb"])
def test_names_that_cannot_be_used(tmp_path, name):
    with pytest.raises(KeysError, match="is not a valid member name"):
        keys.make_team(str(tmp_path / "keys"), [NewMember(name, "robot")], 30)


def test_revoked_members_leave_every_allow_list_and_come_back_under_another_common_name(team):
    first = keys.read_keys(own(team, "robot_1")).member
    keys.revoke(team, "robot_1")
    assert not os.path.exists(own(team, "robot_1"))
    assert [m.name for m in keys.read_keys(own(team, "hub")).members] == ["robot 2", "ann", "hub"]
    keys.add_members(team, [NewMember("robot_1", "robot")], 30)
    again = keys.read_keys(own(team, "robot_1")).member
    assert (again.name, again.common_name) == ("robot_1", "robot_1#2")
    assert again.serial != first.serial
    allowed = keys.read_keys(own(team, "hub")).members
    assert "robot_1" not in [m.common_name for m in allowed]
    with pytest.raises(KeysError, match=r"'bob' is not in the team \(members: ann, hub"):
        keys.revoke(team, "bob")


def test_a_member_does_not_use_keys_that_were_revoked(team, tmp_path):
    os.rename(own(team, "robot_1"), str(tmp_path / "stolen"))
    keys.revoke(team, "robot_1")
    os.replace(own(team, "team.json"), str(tmp_path / "stolen" / "team.json"))
    with pytest.raises(KeysError, match="the certificate of 'robot_1' was revoked on"):
        keys.read_keys(str(tmp_path / "stolen"))


def test_expired_certificates_are_not_used(team, monkeypatch):
    later = keys._now() + datetime.timedelta(days=31)
    monkeypatch.setattr(keys, "_now", lambda: later)
    with pytest.raises(KeysError, match="the certificate of 'ann' expired on"):
        keys.read_keys(own(team, "ann"))


def test_a_key_that_others_can_read_is_not_used(team):
    os.chmod(os.path.join(team, "ann", "key.pem"), 0o640)
    with pytest.raises(KeysError, match=r"other users can read this private key \(chmod 600"):
        keys.read_keys(own(team, "ann"))


def test_the_folder_of_the_whole_team_is_not_given_to_a_robot(team):
    with pytest.raises(KeysError, match="holds the keys of the whole team"):
        keys.read_keys(team)


@pytest.mark.parametrize(
    "content, message",
    [
        ("{", "is not JSON"),
        ("[]", "is not an allow-list of format version 1"),
        ('{"version": 2, "members": []}', "is not an allow-list of format version 1"),
        ('{"version": 1, "members": [{}]}', "member 1: lacks: name, role"),
        ("[" * 100_000, "is not JSON"),
    ],
)
def test_a_damaged_allow_list_is_named(team, content, message):
    with open(os.path.join(team, "ann", "team.json"), "w") as file:
        file.write(content)
    with pytest.raises(KeysError, match=message) as raised:
        keys.read_keys(own(team, "ann"))
    assert raised.value.file == os.path.join(team, "ann", "team.json")


@pytest.mark.parametrize("name", ["certificate.pem", "authority.pem"])
def test_a_damaged_certificate_is_named(team, name):
    with open(os.path.join(team, "ann", name), "w") as file:
        file.write("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
    with pytest.raises(KeysError, match="is not a certificate"):
        keys.read_keys(own(team, "ann"))


def test_the_verb_makes_shows_and_revokes(tmp_path, capsys):
    folder = str(tmp_path / "keys")
    made = main(
        [
            "keys",
            "team",
            folder,
            "--robots",
            "r1",
            "r2",
            "--routers",
            "hub=127.0.0.1",
            "--days",
            "9",
        ]
    )
    assert made == 0
    assert "r1   robot     valid until" in capsys.readouterr().out
    assert main(["keys", "add", folder, "--operators", "ann"]) == 0
    assert main(["keys", "revoke", folder, "r2"]) == 0
    capsys.readouterr()
    assert main(["keys", "show", folder, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["members"]
    assert [(m["name"], m["role"], bool(m["revoked"])) for m in told] == [
        ("r1", "robot", False),
        ("r2", "robot", True),
        ("hub", "router", False),
        ("ann", "operator", False),
    ]


def test_no_command_prints_a_key(tmp_path, capfd):
    folder = str(tmp_path / "keys")
    main(["keys", "team", folder, "--robots", "r1", "--json"])
    main(["keys", "show", folder])
    told = capfd.readouterr()
    lines = read(os.path.join(folder, "r1", "key.pem")).splitlines()[1:-1]
    assert not any(line in told.out + told.err for line in lines)
    assert "PRIVATE" not in told.out + told.err


@pytest.mark.parametrize(
    "words, message",
    [
        (["keys", "team", "DIR"], "no member was named"),
        (["keys", "team", "DIR", "--routers", "hub"], "router 'hub' has no address"),
        (["keys", "team", "DIR", "--robots", "a", "a"], "'a' is named twice"),
        (
            ["keys", "team", "DIR", "--robots", "a", "--days", "0"],
            "a validity of 0 days is not possible",
        ),
        (["keys", "show", "DIR"], "cannot be read"),
        (["keys", "revoke", "DIR", "a"], "cannot be read"),
    ],
)
def test_wrong_use_is_named(tmp_path, capsys, words, message):
    folder = str(tmp_path / "none")
    assert main([folder if word == "DIR" else word for word in words]) == 2
    assert message in capsys.readouterr().err
    assert not os.path.exists(folder)


def test_a_robot_finds_its_keys_in_its_folder_or_in_the_teams(team):
    assert keys.keys_of_robot(team, "robot_1").folder == own(team, "robot_1")
    assert keys.keys_of_robot(own(team, "robot_1"), "robot_1").member.name == "robot_1"
    for folder, robot in ((own(team, "ann"), "ann"), (own(team, "robot_1"), "robot 2")):
        with pytest.raises(KeysError, match="not of robot '%s'" % robot):
            keys.keys_of_robot(folder, robot)
