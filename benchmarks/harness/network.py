"""Network namespaces joined by a bridge. The bridge is in a namespace too, so the host's own
network is not touched."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import shutil
import socket
import subprocess
import time
from typing import Any, Dict, Iterator, List, Optional, Sequence

import psutil

from benchmarks.harness import relay
from benchmarks.harness.gateways import Gateways
from benchmarks.harness.rules import Cuts, ruleset
from gspn_framework_package.model.errors import ExecutionError

PREFIX = "gspn-lab-"
"""Prefix of the names of the namespaces; the process id of their creator follows it."""

SUBNET = "10.77.0."
PROBE_PORT = 7777
_PATH = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
_CLONE_NEWNET = 0x40000000
_numbers = itertools.count(1)
_libc = ctypes.CDLL(None, use_errno=True)

ARRIVAL = 5.0
"""Longest time (s) to wait for a datagram that must arrive, on a busy machine; the wait is shorter
for one that must not."""


class Network:
    """Nodes with an address each, which can be cut off from one another. The network ends with the
    ``with`` block, as does everything that still runs in its namespaces.

    :param nodes: names, at most 15 characters each.
    :param delay: time (s) that a frame takes from any node to any other.
    :param loss: share (0 to below 1) of the frames that are lost on the way from any node to any
        other.
    :param gateways: which of the nodes are gateways, and which hosts are behind them.
    :raises ExecutionError: this machine does not allow it.
    """

    def __init__(
        self,
        nodes: Sequence[str],
        delay: float = 0.0,
        loss: float = 0.0,
        gateways: Optional[Gateways] = None,
    ) -> None:
        self.nodes = list(nodes)
        self.delay, self.loss = delay, loss
        self.gateways = gateways if gateways is not None else Gateways({})
        self.cuts: Cuts = frozenset()
        self._prefix = "%s%d-%d-" % (PREFIX, os.getpid(), next(_numbers))
        self._hub = self._prefix + "_bridge"
        self._addresses = {name: SUBNET + str(number) for number, name in enumerate(nodes, 1)}
        self._addresses.update(self.gateways.addresses())
        self._relay: Optional[relay.Relay] = None

    def address(self, node: str) -> str:
        """IPv4 address of a node or host."""
        return self._addresses[node]

    def namespace(self, node: str) -> str:
        """Name of the namespace of a node or host."""
        return self._prefix + node

    def __enter__(self) -> Network:
        sweep()
        try:
            self._build()
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, *_: Any) -> None:
        self._remove()

    def _build(self) -> None:
        for namespace in self._namespaces():
            _run("ip", "netns", "add", namespace)
            _run("ip", "-n", namespace, "link", "set", "lo", "up")
        _run("ip", "-n", self._hub, "link", "add", "name", "bridge", "type", "bridge")
        _run("ip", "-n", self._hub, "link", "set", "bridge", "up")
        if self.delay:
            # each frame passes the relay twice
            self._relay = relay.Relay([self._taps(n) for n in self.nodes], self.delay / 2)
            self._relay.start()
        for node in self.nodes:
            here = self.namespace(node)
            if not self.delay:
                _run("ip", "-n", self._hub, *_veth(node, here))
            _run("ip", "-n", self._hub, "link", "set", "dev", node, "master", "bridge", "up")
            _run("ip", "-n", here, "addr", "add", self.address(node) + "/24", "dev", "eth0")
            _run("ip", "-n", here, "link", "set", "eth0", "up")
        self._build_gateways()
        self.cut(frozenset())

    def _build_gateways(self) -> None:
        """Attach the hosts to their gateways, and have these translate addresses."""
        for gateway in self.gateways.behind:
            there = self.namespace(gateway)
            for words in self.gateways.commands(gateway):
                _run("ip", "-n", there, *words)
            for host in self.gateways.behind[gateway]:
                here = self.namespace(host)
                _run("ip", "-n", there, *_veth(host, here))
                _run("ip", "-n", there, "link", "set", "dev", host, "master", "lan", "up")
                for words in self.gateways.host_commands(host):
                    _run("ip", "-n", here, *words)
            _run("ip", "netns", "exec", there, "sysctl", "-qw", "net.ipv4.ip_forward=1")
            _run("ip", "netns", "exec", there, "nft", "-f", "-", given=self.gateways.ruleset())

    def move(self, gateway: str) -> None:
        """Give a gateway another address, as providers do: what it translated so far is
        forgotten."""
        there = self.namespace(gateway)
        old = self._addresses[gateway]
        first, last = old.rsplit(".", 1)
        new = "%s.%d" % (first, int(last) + 100 if int(last) <= 100 else int(last) - 100)
        _run("ip", "-n", there, "addr", "del", old + "/24", "dev", "eth0")
        _run("ip", "-n", there, "addr", "add", new + "/24", "dev", "eth0")
        self._addresses[gateway] = new

    def _namespaces(self) -> List[str]:
        return [self.namespace(n) for n in (*self.nodes, *self.gateways.hosts)] + [self._hub]

    def _taps(self, node: str) -> Any:
        try:
            with inside(self.namespace(node)):
                end = relay.open_tap("eth0")
            with inside(self._hub):
                return end, relay.open_tap(node)
        except OSError as error:
            raise ExecutionError(
                "no TAP device (%s)" % error.strerror, element=relay.DEVICE
            ) from None

    def _remove(self) -> None:
        remove_namespaces(self._namespaces())
        if self._relay is not None:
            self._relay.close()
            self._relay = None

    def cut(self, cuts: Cuts) -> None:
        """From now on, block the traffic of these pairs, and let all other traffic through."""
        _run("ip", "netns", "exec", self._hub, "nft", "-f", "-", given=ruleset(cuts, self.loss))
        self.cuts = cuts

    def heal(self) -> None:
        """Let everything through again."""
        self.cut(frozenset())

    def command(self, node: str, words: Sequence[str]) -> List[str]:
        """The command line that runs ``words`` in a node's namespace, as the same process."""
        return [_program("ip"), "netns", "exec", self.namespace(node), *words]

    def travel_time(self, source: str, target: str, patience: float = ARRIVAL) -> Optional[float]:
        """The time (s) that a datagram takes from one node to the other; None: it did not arrive
        within ``patience`` seconds."""
        with inside(self.namespace(target)), socket.socket(
            socket.AF_INET, socket.SOCK_DGRAM
        ) as receiver:
            receiver.bind((self.address(target), PROBE_PORT))
            receiver.settimeout(patience)
            with inside(self.namespace(source)), socket.socket(
                socket.AF_INET, socket.SOCK_DGRAM
            ) as sender:
                sent = time.monotonic()
                try:
                    sender.sendto(b"probe", (self.address(target), PROBE_PORT))
                except OSError:  # there is no way to a host behind a gateway
                    return None
            try:
                receiver.recv(16)
            except socket.timeout:
                return None
            return time.monotonic() - sent

    def verify(self) -> None:
        """Check that the cut traffic, and only that, is blocked, and that the hosts behind a
        gateway reach the nodes, and are not reached from there.

        :raises ExecutionError: some cut traffic gets through, or other traffic does not.
        """
        places = (*self.nodes, *self.gateways.hosts)
        for source in places:
            for target in places:
                if source == target or self.gateways.of(target) == source:
                    continue
                cut = not self._passes(source, target)
                arrived = self._arrives(source, target, cut)
                if arrived == cut:
                    raise ExecutionError(
                        "a datagram from %s to %s %s"
                        % (source, target, "arrived" if arrived else "was lost")
                    )

    def _passes(self, source: str, target: str) -> bool:
        """Whether anything may get from one place to another."""
        way_out, way_in = self.gateways.of(source), self.gateways.of(target)
        if way_in:
            return way_in == way_out
        return way_out == target or (way_out or source, target) not in self.cuts

    def _arrives(self, source: str, target: str, cut: bool) -> bool:
        """Whether a datagram arrives; one is enough where some are lost."""
        for _ in range(3 if cut and self.loss else 40 if self.loss else 1):
            patience = 0.05 + 4 * self.delay
            if not cut and not self.loss:
                patience = ARRIVAL
            if self.travel_time(source, target, patience) is not None:
                return True
        return False


def _veth(name: str, there: str) -> List[str]:
    """The words that make a cable from here, where its end is called ``name``, to ``eth0`` in the
    namespace ``there``."""
    ends = ["type", "veth", "peer", "name", "eth0", "netns", there]
    return ["link", "add", "name", name, *ends]


def why_impossible(delay: float = 0.0) -> str:
    """Why such a network is impossible on this machine; "" if it is possible."""
    for program, package in (("ip", "iproute2"), ("nft", "nftables")):
        if shutil.which(program, path=_PATH) is None:
            return "there is no program '%s' (package %s)" % (program, package)
    if os.geteuid() != 0:
        return "network namespaces need root"
    try:
        with Network(["probe_1", "probe_2"], delay) as network:
            network.verify()
    except (ExecutionError, OSError) as error:
        return str(error)
    return ""


@contextlib.contextmanager
def inside(namespace: str) -> Iterator[None]:
    """Put this thread into a network namespace during the ``with`` block. Sockets and devices that
    it creates there stay there."""
    home = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    try:
        there = os.open("/run/netns/" + namespace, os.O_RDONLY)
        try:
            _enter(there)
        finally:
            os.close(there)
        try:
            yield
        finally:
            _enter(home)
    finally:
        os.close(home)


def _enter(descriptor: int) -> None:
    if _libc.setns(descriptor, _CLONE_NEWNET) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def sweep() -> None:
    """Remove what ended processes have left behind."""
    left = []
    for line in _run("ip", "netns", "list").splitlines():
        name = line.split(" ")[0]
        if name.startswith(PREFIX):
            owner = name[len(PREFIX) :].split("-")[0]
            if not os.path.exists("/proc/" + owner):
                left.append(name)
    remove_namespaces(left)


def remove_namespaces(names: Sequence[str]) -> None:
    """Kill what runs in the namespaces, and remove those that exist."""
    for name in names:
        if not os.path.exists("/run/netns/" + name):
            continue
        deadline = time.monotonic() + 5
        while time.monotonic() < deadline:
            inside = list(_processes_of(name))
            if not inside:
                break
            for process in inside:
                with contextlib.suppress(psutil.NoSuchProcess):
                    process.kill()
            time.sleep(0.02)
        _run("ip", "netns", "delete", name)


def _processes_of(name: str) -> Iterator[psutil.Process]:
    """Processes in a namespace, and those on their way into it.

    ``ip netns exec`` is in the namespace of its caller for a moment. Its words are read before
    its namespace, so that none slips through between the two.
    """
    there = os.stat("/run/netns/" + name)
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.status() == psutil.STATUS_ZOMBIE:
                continue
            enters = ["netns", "exec", name] == process.cmdline()[1:4]
            if enters or os.path.samestat(os.stat("/proc/%d/ns/net" % process.pid), there):
                yield process


def _program(name: str) -> str:
    return shutil.which(name, path=_PATH) or name


def _run(*words: str, given: str = "") -> str:
    environment: Dict[str, str] = dict(os.environ, PATH=_PATH)
    try:
        done = subprocess.run(
            [_program(words[0]), *words[1:]],
            input=given,
            capture_output=True,
            text=True,
            env=environment,
            timeout=20,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ExecutionError("'%s' failed: %s" % (" ".join(words), error)) from None
    if done.returncode != 0:
        raise ExecutionError(
            "'%s' failed: %s" % (" ".join(words), done.stderr.strip() or done.stdout.strip())
        )
    return done.stdout
