"""Manages the keys of a team: its certificate authority, and a certificate for each robot,
operator, watcher and router.

The folder that :func:`make_team` writes::

    team.json who is in the team: the allow-list (no secrets) authority/ certificate and key of the
    authority; stays with the operator NAME/ for each member: the files to copy to that member, and
    to no other authority.pem certificate.pem key.pem team.json

A certificate has its member's name as common name. A name that is reused after a revocation gets a
different common name (``robot_2#2``), so that the allow-list distinguishes the new certificate from
the stolen one. Zenoh does not support revocation lists, so routers enforce the allow-list (see
docs/security.md).
"""

from __future__ import annotations

import contextlib
import datetime
import ipaddress
import json
import os
import shutil
import stat
import tempfile
from typing import TYPE_CHECKING, Any, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.errors import KeysError, how_to_install

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

ROLES = ("robot", "operator", "watcher", "router")
"""A ``robot`` takes part, an ``operator`` gives orders and watches, a ``watcher`` only watches, and
a ``router`` forwards messages and enforces who may send what."""

TEAM_FILE = "team.json"
AUTHORITY = "authority"
LONGEST_OPERATOR_NAME = 48
"""Maximum number of characters of a name: a common name has at most 64, and also contains a
number."""

_KEY_FILE_BYTES = 10_000_000
_VERSION = 1
_AUTHORITY_DAYS = 3650
_CLOCKS_DIFFER = datetime.timedelta(days=1)


class NewMember(NamedTuple):
    """A new member: its name, its role, and the addresses at which it listens (host names or IP
    addresses), which connecting members verify."""

    name: str
    role: str
    hosts: Tuple[str, ...] = ()


class KeyHolder(NamedTuple):
    """An entry of the allow-list. ``serial`` is the certificate's serial number in hexadecimal,
    ``expires`` its end (ISO 8601, UTC) and ``revoked`` the time of its revocation ("" if it is
    valid)."""

    name: str
    role: str
    common_name: str
    serial: str
    expires: str
    revoked: str = ""


class KeyFolder(NamedTuple):
    """The validated keys of one member."""

    folder: str
    member: KeyHolder
    members: Tuple[KeyHolder, ...]
    """The members of the team whose certificates are not revoked."""

    @property
    def authority(self) -> str:
        """Path of the authority's certificate."""
        return os.path.join(self.folder, "authority.pem")

    @property
    def certificate(self) -> str:
        """Path of the member's certificate."""
        return os.path.join(self.folder, "certificate.pem")

    @property
    def key(self) -> str:
        """Path of the member's private key."""
        return os.path.join(self.folder, "key.pem")


# -- creating keys ---------------------------------------------------------------------------------


def make_team(folder: str, members: Sequence[NewMember], days: int) -> List[KeyHolder]:
    """Create an authority, and keys for each member.

    :param folder: must be empty or not exist yet.
    :param days: number of days for which the certificates are valid.
    :raises KeysError: a name cannot be used, or the folder is not empty or cannot be written.
    """
    _check_new(members, days, [])
    if os.path.lexists(folder) and (not os.path.isdir(folder) or os.listdir(folder)):
        raise KeysError(
            "already exists; nothing was written",
            file=folder,
            hint="choose a new folder, or add members with 'gspn keys add'",
        )
    parent = os.path.dirname(os.path.abspath(folder))
    with _reported("written", folder):
        os.makedirs(parent, exist_ok=True)
        half_made = tempfile.mkdtemp(prefix=".keys-", dir=parent)
        try:
            _Authority.make(half_made, days)
            rows = _issue(half_made, members, days, [])
            os.rename(half_made, folder)
        finally:
            shutil.rmtree(half_made, ignore_errors=True)
    return rows


def add_members(folder: str, members: Sequence[NewMember], days: int) -> List[KeyHolder]:
    """Create keys for further members. A revoked name gets a new certificate.

    :returns: the whole allow-list.
    :raises KeysError: a name is already in use or is not allowed, or the folder holds no keys.
    """
    there = read_team(folder)
    _check_new(members, days, there)
    with _reported("written", folder):
        return _issue(folder, members, days, there)


def revoke(folder: str, name: str) -> List[KeyHolder]:
    """Remove a member from the allow-list in every member's folder, and delete its keys here.

    :returns: the whole allow-list.
    :raises KeysError: there is no such member, or the folder holds no keys.
    """
    rows = read_team(folder)
    if name not in _valid_names(rows):
        known = ", ".join(sorted(_valid_names(rows))) or "nobody"
        raise KeysError("'%s' is not in the team (members: %s)" % (name, known), file=folder)
    now = _told(_now())
    rows = [
        row._replace(revoked=now) if row.name == name and not row.revoked else row for row in rows
    ]
    with _reported("written", folder):
        _write_team(folder, rows)
        shutil.rmtree(os.path.join(folder, name), ignore_errors=True)
    return rows


@contextlib.contextmanager
def _reported(done: str, path: str, hint: str = "") -> Iterator[None]:
    """Report what the system refuses. :raises KeysError: the file cannot be ``done``."""
    try:
        yield
    except OSError as error:
        raise KeysError(
            "cannot be %s (%s)" % (done, error.strerror), file=path, hint=hint or None
        ) from None


def _check_new(members: Sequence[NewMember], days: int, there: Sequence[KeyHolder]) -> None:
    _require_library()
    if not 1 <= days <= 36500:
        raise KeysError("a validity of %d days is not possible" % days, hint="1 to 36500")
    if not members:
        raise KeysError("no member was named", hint="--robots NAME ...")
    names = _valid_names(there)
    for new in members:
        wrong = (
            not 0 < len(new.name) <= LONGEST_OPERATOR_NAME
            or new.name in (AUTHORITY, TEAM_FILE)
            or new.name.startswith((".", "-"))
            or not new.name.isprintable()
            or any(c in new.name for c in "/\\#*$?")
        )
        if wrong:
            raise KeysError(
                "'%.60s' is not a valid member name" % new.name,
                hint="use at most %d characters, and none of / \\ # * $ ?" % LONGEST_OPERATOR_NAME,
            )
        if new.name in names:
            raise KeysError(
                "'%s' is named twice" % new.name
                if not there
                else "'%s' already has keys" % new.name,
                hint="give each member a different name"
                if not there
                else "revoke the present keys first",
            )
        names.add(new.name)


def _valid_names(rows: Sequence[KeyHolder]) -> Set[str]:
    return {row.name for row in rows if not row.revoked}


def _issue(
    folder: str, members: Sequence[NewMember], days: int, there: List[KeyHolder]
) -> List[KeyHolder]:
    """Write the keys of new members, then the allow-list with them."""
    authority = _Authority.read(folder)
    rows = list(there)
    for new in members:
        earlier = sum(row.name == new.name for row in rows)
        common_name = "%s#%d" % (new.name, earlier + 1) if earlier else new.name
        certificate, key = authority.certify(common_name, new.hosts, days)
        own = os.path.join(folder, new.name)
        # left by an earlier attempt that did not get onto the list
        shutil.rmtree(own, ignore_errors=True)
        os.mkdir(own, 0o700)
        write_private(os.path.join(own, "authority.pem"), authority.pem)
        write_private(os.path.join(own, "certificate.pem"), _pem(certificate))
        write_private(os.path.join(own, "key.pem"), _key_pem(key))
        expires = _told(_ends(certificate))
        row = KeyHolder(new.name, new.role, common_name, "%x" % certificate.serial_number, expires)
        rows.append(row)
    _write_team(folder, rows)
    return rows


class _Authority(NamedTuple):
    """Signs the certificates of a team."""

    certificate: x509.Certificate
    key: EllipticCurvePrivateKey

    @property
    def pem(self) -> bytes:
        return _pem(self.certificate)

    @classmethod
    def make(cls, folder: str, days: int) -> _Authority:
        from cryptography import x509

        key = _new_key()
        name = "authority of a team of robots"
        builder = _builder(name, name, key, max(days, _AUTHORITY_DAYS)).add_extension(
            x509.BasicConstraints(ca=True, path_length=0), critical=True
        )
        made = cls(_signed(builder, key), key)
        own = os.path.join(folder, AUTHORITY)
        os.mkdir(own, 0o700)
        write_private(os.path.join(own, "certificate.pem"), made.pem)
        write_private(os.path.join(own, "key.pem"), _key_pem(key))
        return made

    @classmethod
    def read(cls, folder: str) -> _Authority:
        from cryptography.hazmat.backends import default_backend
        from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        path = os.path.join(folder, AUTHORITY, "key.pem")
        try:
            with _reported("read", path), open_file(path) as file:
                key = load_pem_private_key(file.read(_KEY_FILE_BYTES), None, default_backend())
        except (ValueError, TypeError):
            raise KeysError("is not a private key", file=path) from None
        if not isinstance(key, EllipticCurvePrivateKey):
            raise KeysError("was not created by 'gspn keys team'", file=path)
        return cls(read_certificate(os.path.join(folder, AUTHORITY, "certificate.pem")), key)

    def certify(
        self, common_name: str, hosts: Sequence[str], days: int
    ) -> Tuple[x509.Certificate, EllipticCurvePrivateKey]:
        """Create a certificate for both client and server authentication, and its key."""
        from cryptography import x509
        from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

        key = _new_key()
        issuer = self.certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
        builder = (
            _builder(common_name, str(issuer), key, days, self.key)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .add_extension(_alternative_names(common_name, hosts), critical=False)
        )
        return _signed(builder, self.key), key


def _alternative_names(common_name: str, hosts: Sequence[str]) -> x509.SubjectAlternativeName:
    from cryptography import x509

    names: List[x509.GeneralName] = []
    for host in hosts:
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
            continue
        except ValueError:
            pass
        if not host.isascii() or not host or len(host) > 253 or " " in host:
            raise KeysError("'%.60s' is neither a host name nor an IP address" % host)
        names.append(x509.DNSName(host))
    names.append(x509.UniformResourceIdentifier("urn:gspn:%s" % common_name.encode().hex()))
    return x509.SubjectAlternativeName(names)


def _builder(
    name: str,
    issuer: str,
    key: EllipticCurvePrivateKey,
    days: int,
    authority: Optional[EllipticCurvePrivateKey] = None,
) -> x509.CertificateBuilder:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    def named(text: str) -> x509.Name:
        return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])

    now = _now()
    return (
        x509.CertificateBuilder()
        .subject_name(named(name))
        .issuer_name(named(issuer))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_DIFFER)
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key((authority or key).public_key()),
            critical=False,
        )
    )


def _signed(builder: x509.CertificateBuilder, key: EllipticCurvePrivateKey) -> x509.Certificate:
    from cryptography.hazmat.backends import default_backend
    from cryptography.hazmat.primitives import hashes

    return builder.sign(key, hashes.SHA256(), default_backend())


def _new_key() -> EllipticCurvePrivateKey:
    """Generate a P-256 key, a curve that every TLS library supports."""
    from cryptography.hazmat.backends import default_backend
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1(), default_backend())


def _pem(certificate: x509.Certificate) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding

    return certificate.public_bytes(Encoding.PEM)


def _key_pem(key: EllipticCurvePrivateKey) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def write_private(path: str, content: bytes) -> None:
    """Create a file that only its owner can read.

    :raises OSError: the file exists already, or cannot be written.
    """
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


def _write_team(folder: str, rows: Sequence[KeyHolder]) -> None:
    """Write the allow-list to the team's folder and to each member's."""
    text = json.dumps({"version": _VERSION, "members": [r._asdict() for r in rows]}, indent=1)
    own = [os.path.join(folder, name) for name in sorted(_valid_names(rows))]
    for place in [*filter(os.path.isdir, own), folder]:
        new = os.path.join(place, TEAM_FILE + ".new")
        with contextlib.suppress(FileNotFoundError):
            os.remove(new)
        write_private(new, (text + "\n").encode())
        os.replace(new, os.path.join(place, TEAM_FILE))


# -- reading keys ----------------------------------------------------------------------------------


def read_team(folder: str) -> List[KeyHolder]:
    """Read the allow-list of a folder, including revoked entries.

    :raises KeysError: the folder has no allow-list, or it is damaged.
    """
    path = os.path.join(folder, TEAM_FILE)
    hint = "create a folder with keys by 'gspn keys team'"
    try:
        with _reported("read", path, hint), open_file(path) as file:
            data: Any = json.loads(file.read(_KEY_FILE_BYTES).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise KeysError("is not JSON (%s)" % error, file=path) from None
    rows = data.get("members") if isinstance(data, dict) else None
    if not isinstance(rows, list) or data.get("version") != _VERSION:
        raise KeysError("is not an allow-list of format version %d" % _VERSION, file=path)
    return [_member(row, number, path) for number, row in enumerate(rows, 1)]


def _member(row: Any, number: int, path: str) -> KeyHolder:
    fields = KeyHolder._fields
    if not isinstance(row, dict) or sorted(row) != sorted(fields):
        raise KeysError("lacks: %s" % ", ".join(fields), file=path, element="member %d" % number)
    if not all(isinstance(value, str) for value in row.values()) or row["role"] not in ROLES:
        raise KeysError(
            "has an invalid value for a member", file=path, element="member %d" % number
        )
    return KeyHolder(**row)


def read_keys(folder: str) -> KeyFolder:
    """Read the keys of one member from the folder that was copied to it.

    :raises KeysError: the keys are incomplete, damaged, expired or revoked, or other users can read
        the private key.
    """
    if os.path.isdir(os.path.join(folder, AUTHORITY)):
        names = ", ".join(sorted(_valid_names(read_team(folder))))
        raise KeysError(
            "holds the keys of the whole team",
            file=folder,
            hint="name the subfolder of one member: %s" % names,
        )
    rows = read_team(folder)
    keys = KeyFolder(folder, rows[0], tuple(r for r in rows if not r.revoked)) if rows else None
    if keys is None:
        raise KeysError("does not name a member", file=os.path.join(folder, TEAM_FILE))
    certificate = read_certificate(keys.certificate)
    read_certificate(keys.authority)
    check_private(keys.key)
    serial = "%x" % certificate.serial_number
    row = next((row for row in rows if row.serial == serial), None)
    if row is None:
        raise KeysError("is not on the allow-list in its folder", file=keys.certificate)
    if row.revoked:
        raise KeysError(
            "the certificate of '%s' was revoked on %s" % (row.name, row.revoked[:10]),
            file=keys.certificate,
        )
    if _ends(certificate) < _now():
        raise KeysError(
            "the certificate of '%s' expired on %s" % (row.name, row.expires[:10]),
            file=keys.certificate,
            hint="run 'gspn keys revoke', then 'gspn keys add'; or correct this machine's clock",
        )
    return keys._replace(member=row)


def keys_of_robot(folder: str, robot: str) -> KeyFolder:
    """Read the keys of a robot or witness, from its folder or from the parent folder, in which the
    robot's name is looked up.

    :raises KeysError: as :func:`read_keys`, or the keys belong to another member.
    """
    own = os.path.join(folder, robot)
    keys = read_keys(own if os.path.isdir(own) else folder)
    if (keys.member.role, keys.member.name) != ("robot", robot):
        raise KeysError(
            "these are the keys of %s '%s', not of robot '%s'"
            % (keys.member.role, keys.member.name, robot),
            file=keys.folder,
            hint="gspn keys add DIR --robots %s" % robot,
        )
    return keys


def check_private(path: str, hint: str = "") -> None:
    """Check that only its owner can read a secret file.

    :param hint: what to do if the file does not exist.
    :raises KeysError: the file does not exist, or other users can read it.
    """
    with _reported("read", path, hint):
        mode = os.stat(path).st_mode
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise KeysError(
            "other users can read this private key", file=path, hint="chmod 600 %s" % path
        )


def read_certificate(path: str) -> x509.Certificate:
    """Read the certificate in a file. :raises KeysError: the file holds no certificate."""
    _require_library()
    from cryptography import x509
    from cryptography.hazmat.backends import default_backend

    try:
        with _reported("read", path), open_file(path) as file:
            return x509.load_pem_x509_certificate(file.read(_KEY_FILE_BYTES), default_backend())
    except ValueError:
        raise KeysError("is not a certificate", file=path) from None


def _require_library() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError:
        raise KeysError(
            "the Python library 'cryptography' is not installed",
            hint=how_to_install("cryptography"),
        ) from None


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc).replace(tzinfo=None, microsecond=0)


def _ends(certificate: x509.Certificate) -> datetime.datetime:
    """When a certificate expires, as a naive UTC time: older versions of the library have no
    other."""
    aware = getattr(certificate, "not_valid_after_utc", None)
    ends: datetime.datetime = aware or certificate.not_valid_after
    return ends.replace(tzinfo=None)


def _told(moment: datetime.datetime) -> str:
    return moment.isoformat() + "Z"
